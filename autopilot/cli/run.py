"""``autopilot run``: the service on a real vehicle."""

from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.click_types import OneOf
from autopilot.cli.console_output import EXIT_LOSS
from autopilot.cli.service_options import (
    DURATION,
    LOG,
    LOG_CAMERA_HZ,
    PLAN,
    foxglove_option,
    opened_foxglove,
    opened_view,
    part_name,
    view_address_option,
    view_option,
)
from autopilot.cli.service_run import Flights, StopSignals, tell_losses
from autopilot.cli.shared_options import CONFIG, INSTANCE, PARAM, QUIET
from autopilot.run.config import PROFILES

if TYPE_CHECKING:
    from autopilot.core.messages import RunEnd
    from autopilot.run.config import EffectiveSettings
    from autopilot.run.session import Session, SessionOptions
    from autopilot.run.vehicle_config import VehicleConfig


@click.command()
@CONFIG
@PLAN
@DURATION
@LOG
@LOG_CAMERA_HZ
@click.option("--connect", multiple=True, help="MAVLink connection; repeatable, replaces the file's.")
@click.option("--controller", callback=part_name, help="Default: the file's, else nmpc.")
@click.option("--estimator", callback=part_name, help="ekf, complementary (default: the file's, else ekf).")
@PARAM
@click.option("--profile", type=OneOf(PROFILES), help="MAVLink identity (default: the file's, else px4).")
@INSTANCE
@view_option
@view_address_option
@foxglove_option
@QUIET
def run(config: str, param: tuple[str, ...], instance: int, quiet: bool, **given: Any) -> None:
    """Run the service on the vehicle of a configuration file. SIGTERM: thrusters neutral, log closed, exit code 0."""
    from autopilot.run.config import gather, parse_overrides, vehicle_defaults
    from autopilot.run.vehicle_config import load_config

    stop, loaded = StopSignals(), load_config(config)
    settings = gather(
        vehicle_defaults(instance),
        given,
        file=loaded.file.service.given(loaded.path.parent),
        file_name=loaded.path.name,
    )
    overrides = parse_overrides(param)
    with (
        opened_view(settings["view"], settings["view_address"]) as view,
        opened_foxglove(settings["foxglove"]) as foxglove,
    ):
        flights = Flights(stop, view, foxglove, quiet=quiet)
        while True:
            session, end = _run(settings, loaded, overrides, instance, flights)
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
    settings: "EffectiveSettings", loaded: "VehicleConfig", overrides: dict[str, float], instance: int, flights: Flights
) -> "tuple[Session, RunEnd | None]":
    """The run, from links to its end, and how an operator has ended it."""
    from autopilot.run.console import EventLines
    from autopilot.run.hardware_session import open_vehicle, open_vehicle_links, state_folder
    from autopilot.run.state_lock import locked_state

    lines = EventLines(lambda text: show(text))

    def make(options: "SessionOptions") -> "Session":
        options["on_tick"] = lines.step
        return open_vehicle(settings, loaded, overrides, instance=instance, **options)

    with (
        locked_state(state_folder(settings, loaded, instance)),
        flights.ready(lambda: open_vehicle_links(settings, loaded, overrides, instance=instance), make) as (
            session,
            show,
        ),
    ):
        devices = ", ".join(f"{kind} {setup.driver}" for kind, setup in loaded.devices.items())
        show(f"{loaded.path.name}: {loaded.vehicle.name}, {devices}, MAVLink on {', '.join(settings['connect'])}")
        session.run(stop=lambda: bool(flights.stop) or lines.run_end is not None)
        counters = session.runtime.counters
        show(
            f"{0.01 * counters.due:.1f} s, {counters.overruns} overruns"
            f" ({100.0 * counters.overruns / max(counters.due, 1):.2f} % of ticks),"
            f" longest tick {1e3 * counters.worst_tick_s:.0f} ms"
        )
    return session, lines.run_end
