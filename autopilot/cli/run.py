"""``autopilot run``: the service on a real vehicle."""

import time
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.finite import FiniteRange
from autopilot.cli.output import EXIT_LOSS
from autopilot.cli.part_name import part_name
from autopilot.cli.service_run import StopSignals, settle_memory, tell_losses
from autopilot.cli.view_option import foxglove_option, opened_foxglove, opened_view, view_option
from autopilot.run.config import PROFILES
from autopilot.run.process_start import process_start_s

if TYPE_CHECKING:
    from autopilot.core.messages import RunEnd
    from autopilot.run.config import Settings
    from autopilot.run.session import Session
    from autopilot.run.vehicle_config import VehicleConfig
    from autopilot.view.foxglove import FoxgloveServer
    from autopilot.view.hub import Hub


@click.command()
@click.option("--config", required=True, metavar="FILE", help="Vehicle configuration: a TOML file, or a shipped name.")
@click.option("--plan", type=click.Path(exists=True, dir_okay=False), help="Preload mission, fence and rally.")
@click.option("--duration", type=FiniteRange(min=0.0, min_open=True), help="End after so many seconds.")
@click.option("--log", type=click.Path(dir_okay=False), help="Log file (default: one per arming in the log folder).")
@click.option("--log-camera-hz", type=FiniteRange(0.0, 100.0), help="Pictures in the log per second (default 2).")
@click.option("--connect", multiple=True, help="MAVLink connection; repeatable, replaces the file's.")
@click.option("--controller", callback=part_name, help="Default: the file's, else nmpc.")
@click.option("--estimator", callback=part_name, help="ekf, complementary (default: the file's, else ekf).")
@click.option("--param", multiple=True, metavar="NAME=VALUE", help="Set a parameter for this run; repeatable.")
@click.option("--profile", type=click.Choice(PROFILES), help="MAVLink identity (default: the file's, else px4).")
@click.option("--instance", type=click.IntRange(0, 99), default=0, show_default=True, help="Instance number.")
@view_option
@foxglove_option
@click.option("--quiet", is_flag=True, help="Print only errors.")
def run(config: str, param: tuple[str, ...], instance: int, quiet: bool, **given: Any) -> None:
    """Run the service on the vehicle of a configuration file. SIGTERM: thrusters neutral, log closed, exit code 0."""
    from autopilot.run.config import gather, parse_overrides, vehicle_defaults
    from autopilot.run.vehicle_config import load_config

    stop, began_s = StopSignals(), process_start_s()
    loaded = load_config(config)
    settings = gather(
        vehicle_defaults(instance),
        given,
        file=loaded.file.service.given(loaded.path.parent),
        file_name=loaded.path.name,
    )
    overrides = parse_overrides(param)
    with opened_view(settings["view"]) as view, opened_foxglove(settings["foxglove"]) as foxglove:
        while True:
            session, end = _run(settings, loaded, overrides, instance, stop, view, foxglove, began_s, quiet=quiet)
            began_s = time.time()
            if stop or end is None or end.value != "again":
                break
            tell_losses(session)
            loaded = load_config(config)
    not_whole = tell_losses(session)
    if stop.interrupted:
        raise click.Abort
    if not_whole:
        click.get_current_context().exit(EXIT_LOSS)


def _run(
    settings: "Settings",
    loaded: "VehicleConfig",
    overrides: dict[str, float],
    instance: int,
    stop: StopSignals,
    view: "Hub | None",
    foxglove: "FoxgloveServer | None",
    began_s: float,
    *,
    quiet: bool,
) -> "tuple[Session, RunEnd | None]":
    """The run, from links to its end, and how an operator has ended it."""
    from autopilot.run.hardware_session import open_vehicle, open_vehicle_links

    with open_vehicle_links(settings, loaded, overrides, instance=instance) as boot:
        from autopilot.run.console import Console, EventLines

        console = None if quiet else Console()
        show = (lambda _: None) if console is None else console.print
        lines = EventLines(show)
        session = open_vehicle(
            settings,
            loaded,
            overrides,
            instance=instance,
            links=boot.links,
            now_s=began_s,
            on_tick=lines.step,
            view=view,
            foxglove=foxglove,
        )
        settle_memory()
    session.runtime.take_over(boot.take_unanswered())
    for warning in session.warnings:
        click.echo(f"warning: {warning}", err=True)
    devices = ", ".join(f"{kind} {setup.driver}" for kind, setup in loaded.devices.items())
    show(f"{loaded.path.name}: {loaded.vehicle.name}, {devices}, MAVLink on {', '.join(settings['connect'])}")
    try:
        session.run(stop=lambda: bool(stop) or lines.run_end is not None)
        counters = session.runtime.counters
        show(
            f"{0.01 * counters.ticks:.1f} s, {counters.overruns} overruns"
            f" ({100.0 * counters.overruns / max(counters.ticks, 1):.2f} % of ticks),"
            f" longest tick {1e3 * counters.worst_tick_s:.0f} ms"
        )
    finally:
        if console is not None:
            console.close()
    return session, lines.run_end
