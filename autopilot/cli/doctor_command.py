"""``autopilot doctor``: check a vehicle before it goes into the water."""

import click

from autopilot.cli.click_types import FiniteRange
from autopilot.cli.completion import PARAM_VALUE
from autopilot.cli.console_output import EXIT_FAILED, EXIT_LOSS, emit_json, print_table
from autopilot.cli.shared_options import CONFIG, INSTANCE, JSON

WARNING = "The thrusters are armed and turn for two seconds. Take all propellers off."


@click.command()
@CONFIG
@click.option("--plan", type=click.Path(exists=True, dir_okay=False), help="Plan to fly instead of the one on board.")
@click.option("--connect", multiple=True, help="MAVLink connection; repeatable, replaces the file's.")
@click.option(
    "--param", type=PARAM_VALUE, multiple=True, metavar="NAME=VALUE", help="Set a parameter for this look; repeatable."
)
@INSTANCE
@click.option("--seconds", type=FiniteRange(1.0, 600.0), default=5.0, show_default=True, help="So long it looks.")
@click.option(
    "--measure-neutral",
    is_flag=True,
    help="Turn the thrusters and measure how long they keep turning without commands.",
)
@click.option("--yes", is_flag=True, help="With --measure-neutral: the propellers are off, do not ask.")
@JSON
def doctor(
    config: str,
    plan: str | None,
    connect: tuple[str, ...],
    param: tuple[str, ...],
    instance: int,
    seconds: float,
    measure_neutral: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Would it arm? The service's own checks on the vehicle's devices, their rates, noise and plausibility, who else
    speaks, and what to do. Nothing moves, unless it is asked to measure how long thrust goes on in silence.

    Exit codes: 0 arming would be accepted, 1 something has to be fixed, 3 warnings.
    """
    if measure_neutral and not yes:
        click.confirm(f"{WARNING} Are they off?", abort=True, err=True)
    from autopilot.analysis.nmpc_flight import FlightTrials
    from autopilot.core.errors import AutopilotError
    from autopilot.run.config import gather, parse_overrides, vehicle_defaults
    from autopilot.run.doctor import examine, failed_config
    from autopilot.run.neutral_time import measure
    from autopilot.run.vehicle_config import load_config

    overrides, given = parse_overrides(param), {"plan": plan, "connect": connect}
    try:
        loaded = load_config(config)
        file = loaded.file.service.given(loaded.path.parent)
        settings = gather(vehicle_defaults(instance), given, file=file, file_name=loaded.path.name)
        findings = examine(loaded, settings, seconds, overrides, instance=instance, flying=FlightTrials())
        findings += [measure(loaded)] if measure_neutral else []
    except AutopilotError as error:
        findings = failed_config(error)
    if as_json:
        emit_json(
            [{"verdict": f.verdict.value, "what": f.what, "found": f.found, "remedy": f.remedy} for f in findings]
        )
    else:
        print_table(
            "Doctor", ("", "what", "found", "to do"), [(f.verdict.value, f.what, f.found, f.remedy) for f in findings]
        )
    verdicts = {finding.verdict.value for finding in findings}
    context = click.get_current_context()
    if "fail" in verdicts:
        context.exit(EXIT_FAILED)
    if "warn" in verdicts:
        context.exit(EXIT_LOSS)
