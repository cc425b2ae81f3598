"""``autopilot doctor``: look a vehicle over before it goes into the water."""

import click

from autopilot.cli.finite import FiniteRange
from autopilot.cli.output import EXIT_LOSS, emit_json, print_table


@click.command()
@click.option("--config", required=True, metavar="FILE", help="Vehicle configuration: a TOML file, or a shipped name.")
@click.option("--seconds", type=FiniteRange(1.0, 600.0), default=5.0, show_default=True, help="So long it looks.")
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
def doctor(config: str, seconds: float, as_json: bool) -> None:
    """What is there, at which rate, how noisy, what is wrong and how to mend it. Nothing moves.

    Exit codes: 0 all well, 1 something has to be mended, 3 warnings.
    """
    from autopilot.core.errors import AutopilotError
    from autopilot.run.config import gather, vehicle_defaults
    from autopilot.run.doctor import Verdict, examine, failed_config
    from autopilot.run.vehicle_config import load_config

    try:
        loaded = load_config(config)
        file = loaded.file.service.given(loaded.path.parent)
        settings = gather(vehicle_defaults(0), {}, file=file, file_name=loaded.path.name)
        findings = examine(loaded, settings, seconds)
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
    verdicts = {finding.verdict for finding in findings}
    context = click.get_current_context()
    if Verdict.FAIL in verdicts:
        context.exit(1)
    if Verdict.WARN in verdicts:
        context.exit(EXIT_LOSS)
