"""``autopilot bench``: the benchmarks, each beside what it is measured against. One command per benchmark."""

import click

from autopilot.cli import bench_judged, bench_replay, bench_rows
from autopilot.cli.bench_rows import Work
from autopilot.cli.bench_tables import TITLES, names
from autopilot.cli.output import emit_json

ALL: dict[str, Work] = {
    "nmpc": bench_rows.nmpc_rows,
    "sitl": bench_rows.sitl_rows,
    "estimator": bench_rows.estimator_rows,
    "pockets": bench_rows.pockets_rows,
    "energy": bench_rows.energy_rows,
    "energy-latency": bench_rows.latency_rows,
    "loop": bench_rows.loop_rows,
}
"""What runs when none is named."""
LONG = ("estimator", "pockets", "energy", "energy-latency")
"""Short when all are run."""

__all__ = ["TITLES", "bench"]


class _Benchmarks(click.Group):
    """Options may stand before the benchmark's name, and one of another benchmark is told to whom it belongs."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """See :class:`click.Group`."""
        return super().parse_args(ctx, self._name_first(args))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """See :class:`click.Group`."""
        name, command, rest = super().resolve_command(ctx, args)
        taken = set() if command is None else _options(command)
        for word in rest:
            option = word.partition("=")[0]
            owners = [each for each, other in self.commands.items() if option in _options(other)]
            if owners and option not in taken:
                plural = "s" if len(owners) > 1 else ""
                raise click.UsageError(f"{option} belongs to the benchmark{plural} {names(owners)}", ctx)
        return name, command, rest

    def _name_first(self, args: list[str]) -> list[str]:
        """``--short nmpc`` as ``nmpc --short``."""
        valued = {option for command in self.commands.values() for option in _options(command, valued=True)}
        before = ""
        for place, word in enumerate(args):
            if before not in valued and not word.startswith("-"):
                return [word, *args[:place], *args[place + 1 :]]
            before = word
        return args


def _options(command: click.Command, *, valued: bool = False) -> set[str]:
    """Spellings of a command's options; ``valued``: only those that take a value."""
    options = [each for each in command.params if isinstance(each, click.Option)]
    return {spelling for each in options if not (valued and each.is_flag) for spelling in each.opts}


@click.group(
    cls=_Benchmarks,
    invoke_without_command=True,
    epilog="Times depend on the machine and on what else it does: each table says how slow the machine is just now.",
)
@click.option("--short", is_flag=True, help="Fewer samples, for a quick look.")
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
@click.pass_context
def bench(ctx: click.Context, short: bool, as_json: bool) -> None:
    """Run a benchmark, or the seven of `make bench` one after the other when none is named.

    `autopilot bench NAME --help` says what it measures and how long it takes. Without a name: nmpc, sitl, loop, and
    the short ones of estimator, pockets, energy and energy-latency.
    """
    if ctx.invoked_subcommand is not None:
        return
    results = {}
    for name, work in ALL.items():
        results[name] = bench_rows.measured(name, work, short=short or name in LONG, as_json=as_json)
    if as_json:
        emit_json(results)


for _command in (
    *(bench_rows.nmpc, bench_rows.sitl, bench_rows.estimator, bench_rows.pockets, bench_rows.energy),
    *(bench_rows.energy_latency, bench_rows.loop, bench_rows.modes),
    *(bench_judged.faults, bench_judged.fuzz, bench_judged.sensor_faults, bench_judged.detection),
    *(bench_judged.vehicles, bench_judged.kills, bench_judged.soak, bench_judged.alarms),
    *(bench_judged.picture_faults, bench_judged.thruster_health),
    *(bench_replay.replay, bench_replay.reference),
):
    bench.add_command(_command)
