"""``autopilot bench``: performance of this machine for this vehicle, each figure beside its baseline.

The project's own studies are not installed: a source checkout has them in tests/bench, and there they are commands
here as well.
"""

import importlib
import sys
from pathlib import Path

import click

from autopilot.cli import bench_rows
from autopilot.cli.bench_rows import SHORT, SITL_HEADS, TITLES, Work, names
from autopilot.cli.console_output import emit_json
from autopilot.cli.shared_options import JSON

ROOT = Path(__file__).resolve().parents[2]
STUDIES = "tests.bench.studies"

KNOWN_STUDIES = (
    *("alarms", "detection", "energy", "energy-latency", "energy-legs", "energy-rivals", "fuzz", "kills"),
    *("picture-faults", "pockets", "reference", "replay", "sensor-faults", "soak", "thruster-health", "turns"),
    "vehicles",
)
"""Studies of a source checkout."""

ALL: dict[str, tuple[str, Work]] = {
    "nmpc": (TITLES["nmpc"], bench_rows.nmpc_rows),
    "sitl": (TITLES["sitl"], bench_rows.sitl_rows),
    "estimator": (TITLES["estimator"], bench_rows.estimator_rows),
    "loop": (TITLES["loop"], bench_rows.loop_rows),
}
"""Benchmarks that run by default, and titles of their tables; in a source checkout some studies, too."""
LONG: list[str] = []
"""Short when all are run."""


class _Benchmarks(click.Group):
    """Options may precede the benchmark's name; an option of another benchmark gives an error that names it."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        return super().parse_args(ctx, self._name_first(args))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] in KNOWN_STUDIES and args[0] not in self.commands:
            raise click.UsageError(f"{args[0]} is a study: run it in a source checkout of this project", ctx)
        name, command, rest = super().resolve_command(ctx, args)
        taken = set() if command is None else _options(command)
        for argument in rest:
            option = argument.partition("=")[0]
            owners = [each for each, other in self.commands.items() if option in _options(other)]
            if owners and option not in taken:
                plural = "s" if len(owners) > 1 else ""
                raise click.UsageError(f"{option} belongs to the benchmark{plural} {names(owners)}", ctx)
        return name, command, rest

    def _name_first(self, args: list[str]) -> list[str]:
        """``--short nmpc`` as ``nmpc --short``."""
        valued = {option for command in self.commands.values() for option in _options(command, valued=True)}
        before = ""
        for place, argument in enumerate(args):
            if before not in valued and not argument.startswith("-"):
                return [argument, *args[:place], *args[place + 1 :]]
            before = argument
        return args


def _options(command: click.Command, *, valued: bool = False) -> set[str]:
    """Spellings of a command's options; ``valued``: only those that take a value."""
    options = [each for each in command.params if isinstance(each, click.Option)]
    return {spelling for each in options if not (valued and each.is_flag) for spelling in each.opts}


def _add_studies() -> None:
    """Add the commands of a source checkout, if this is one."""
    if not (ROOT / "tests" / "bench" / "studies.py").is_file():
        return
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    studies = importlib.import_module(STUDIES)
    for command in studies.COMMANDS:
        bench.add_command(command)
    ALL.update(studies.AMONG_ALL)
    LONG.extend(studies.AMONG_ALL)


@click.group(
    cls=_Benchmarks,
    invoke_without_command=True,
    epilog="Times depend on the machine and on what else it does: each table says how slow the machine is just now."
    " A source checkout has studies of the controller, the estimator and of faults besides.",
)
@SHORT
@JSON
@click.pass_context
def bench(ctx: click.Context, short: bool, as_json: bool) -> None:
    """Run a benchmark, or the eight of `make bench` one after the other when none is named.

    `autopilot bench NAME --help` says what it measures and how long it takes. Without a name: nmpc, sitl, estimator and
    loop; in a source checkout the short ones of pockets, energy, turns and energy-latency, too.
    """
    if ctx.invoked_subcommand is not None:
        return
    results: dict[str, dict[str, object]] = {}
    for name, (title, work) in ALL.items():
        heads = SITL_HEADS if name == "sitl" else None
        results[name] = bench_rows.measured(title, work, short=short or name in LONG, as_json=as_json, heads=heads)
    if as_json:
        emit_json(results)
    bench_rows.end(results)


for _name, (_title, _work) in ALL.items():
    bench.add_command(bench_rows.rows_command(_name, _title, _work, SITL_HEADS if _name == "sitl" else None))
_add_studies()
