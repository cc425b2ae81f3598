"""``autopilot``: the command line. Sub-commands are imported only when they are called, so that --help is quick."""

import importlib
import os
import sys
from collections.abc import Callable

import click

from autopilot import __version__
from autopilot.cli.console_output import EXIT_FAILED
from autopilot.core.errors import AutopilotError, SourceError
from autopilot.core.extras import ANALYSIS, without

_COMMANDS: dict[str, tuple[str, str]] = {
    "bench": ("autopilot.cli.bench:bench", "Benchmarks, side by side with their baselines."),
    "calibrate": ("autopilot.cli.calibrate:calibrate", "Calibrate camera, laser, mounting, latency, thrusters."),
    "campaign": ("autopilot.cli.campaign:campaign", "Monte Carlo over seeds and spreads of a scenario, resumable."),
    "certify": ("autopilot.cli.certify:certify", "Margins, Lipschitz sets and terminal regions of a plan."),
    "config": ("autopilot.cli.config_command:config", "Show the effective configuration; copy one to edit."),
    "currents": ("autopilot.cli.currents_command:currents", "Check current maps, make the benchmark's."),
    "demo": ("autopilot.cli.demo_command:demo", "Fly the paper's mission in the simulated tank and judge it."),
    "doctor": (
        "autopilot.cli.doctor_command:doctor",
        "Whether a real vehicle would arm, and if not, why and what to do.",
    ),
    "emulate": ("autopilot.cli.emulate:emulate", "Be a vehicle's flight controller, to try `run` on."),
    "failsafes": (
        "autopilot.cli.params_command:failsafes",
        "The table of failsafes: conditions, parameters, effects.",
    ),
    "identify": ("autopilot.cli.identify:identify", "Masses and drags of a vehicle from logs of its flights."),
    "log": ("autopilot.cli.log:log", "Look into logs: check, report, plot, export, diff, recover, replay and more."),
    "markers": ("autopilot.cli.markers_command:markers", "Print marker boards, check and survey marker maps."),
    "mavlink": ("autopilot.cli.mavlink:mavlink", "Make, show or forget the key that frames are signed with."),
    "mission": ("autopilot.cli.mission:mission", "Upload, download, start or check a plan."),
    "motors": ("autopilot.cli.motors:motors", "Turn thrusters one by one, a little, on the bench."),
    "params": ("autopilot.cli.params_command:params", "List, explain and compare parameters."),
    "physics": ("autopilot.cli.emulate:physics", "Be the water and the hull under ArduPilot's own simulation."),
    "run": ("autopilot.cli.run:run", "Run the service on a real vehicle."),
    "scenario": (
        "autopilot.cli.scenario_command:scenario",
        "Scenario files: check one, copy one to edit, list what is shipped.",
    ),
    "sitl": ("autopilot.cli.sitl_command:sitl", "Run the service on a simulated vehicle."),
    "vehicle": (
        "autopilot.cli.vehicle_command:vehicle",
        "Vehicle files: check one, write a template, list what is shipped.",
    ),
}
"""Name -> (module:attribute, one line of help)."""

EXIT_INTERRUPTED = 130


class LazyGroup(click.Group):
    """Imports a command only when it is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command."""
        if cmd_name not in _COMMANDS:
            return None
        module, attribute = _COMMANDS[cmd_name][0].split(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Help from the table, nothing imported."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in sorted(_COMMANDS.items())])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="autopilot")
def cli() -> None:
    """Autopilot for small underwater vehicles.

    Exit codes: 0 ok, 1 failed, 2 usage, 3 done with warnings or loss, 130 interrupted.
    """


def run(command: Callable[[], object]) -> int:
    """Run a click command; exceptions become one line on stderr and an exit code."""
    try:
        result = command()
        return result if isinstance(result, int) else 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        click.echo(f"error: {_one_line(error)}", err=True)
        return error.exit_code
    except (click.Abort, KeyboardInterrupt) as end:
        if isinstance(end.__cause__, EOFError):
            raise end.__cause__ from None  # click takes a file that ends early for a closed terminal
        click.echo("interrupted", err=True)
        return EXIT_INTERRUPTED
    except AutopilotError as error:
        click.echo(f"error: {error}", err=True)
        return click.UsageError.exit_code if isinstance(error, SourceError) else EXIT_FAILED
    except ModuleNotFoundError as error:
        library = str(error.name).partition(".")[0]
        if library not in ANALYSIS:
            raise
        click.echo(f"error: {without(library)}", err=True)
        return EXIT_FAILED
    except BrokenPipeError:
        # The reader of our output has closed it (`| head`). Python would complain at exit when it flushes the rest.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED


def _one_line(error: click.ClickException) -> str:
    """Usage error in one line, with the help command."""
    text = " ".join(error.format_message().split()).rstrip(".")
    context = error.ctx if isinstance(error, click.UsageError) else None
    return text if context is None else f"{text}; see '{context.command_path} --help'"


def main() -> None:
    """Entry point of the console script."""
    sys.exit(run(lambda: cli(prog_name="autopilot", standalone_mode=False)))


if __name__ == "__main__":
    main()
