"""``autopilot sitl``: the service on a simulated vehicle."""

from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.click_types import FiniteRange, OneOf
from autopilot.cli.completion import SCENARIO_NAME
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
    view_option,
)
from autopilot.cli.service_run import Flights, StopSignals, tell_losses
from autopilot.cli.shared_options import INSTANCE, PARAM, QUIET, SCENARIO_VEHICLE, SEED
from autopilot.core.errors import AutopilotError
from autopilot.run.config import BASINS, CURRENTS, PROFILES, SENSORS, UNTIL, WIRES

if TYPE_CHECKING:
    from autopilot.run.config import EffectiveSettings
    from autopilot.run.session import SessionOptions
    from autopilot.run.sitl_console import RunWatch
    from autopilot.run.sitl_session import SitlSession


@click.command()
@click.argument("scenario", type=SCENARIO_NAME, required=False)
@SCENARIO_VEHICLE
@PLAN
@click.option("--speed", type=FiniteRange(min=0.0), help="1 = real time (default), 0 = as fast as possible.")
@SEED
@DURATION
@LOG
@LOG_CAMERA_HZ
@click.option("--connect", multiple=True, help="MAVLink connection; repeatable, replaces the defaults.")
@click.option("--controller", callback=part_name, help="Default: the scenario's, else nmpc.")
@click.option("--estimator", callback=part_name, help="ekf, complementary (default: the scenario's, else ekf).")
@click.option("--plant", callback=part_name, help="Default: the scenario's, else rigid-body.")
@click.option("--sensors", type=OneOf(SENSORS), help="Rendered camera, or a noisy pose (default: scenario's).")
@click.option(
    "--hil",
    multiple=True,
    type=OneOf(WIRES),
    help="Through real drivers and wires; repeatable: AHRS on a serial line, camera as a network stream, PWM board.",
)
@click.option(
    "--markers", type=click.Path(dir_okay=False), help="Marker map that the estimator uses (default: the true one)."
)
@click.option("--currents", type=OneOf(CURRENTS), help="What the controller knows of them (default: scenario's).")
@click.option(
    "--basin", type=OneOf(BASINS), help="Whether what flows comes back within the fence (default: scenario's)."
)
@click.option("--currents-map", type=click.Path(dir_okay=False), help="Current map (.npz, NetCDF): --currents map.")
@click.option("--currents-start", metavar="UTC", help="Date of the start in the map (default: its first frame).")
@PARAM
@click.option("--profile", type=OneOf(PROFILES), help="MAVLink identity (default: px4).")
@INSTANCE
@click.option("--start", is_flag=True, default=None, help="Arm and start the preloaded plan by an operator in-process.")
@click.option("--keep-plans", is_flag=True, default=None, help="Keep plans, fence, home and progress between runs.")
@click.option("--until", type=OneOf(UNTIL), help="End with the mission; exit code 1 if it ends otherwise.")
@view_option
@foxglove_option
@QUIET
def sitl(scenario: str | None, param: tuple[str, ...], instance: int, quiet: bool, **given: Any) -> None:
    """Run the service on the simulated vehicle of SCENARIO (a shipped name or a TOML file; default paper-tank)."""
    from autopilot.run.config import gather, parse_overrides, sitl_defaults

    settings = gather(sitl_defaults(instance), {"scenario": scenario, **given})
    stop, overrides = StopSignals(), parse_overrides(param)
    with opened_view(settings["view"]) as view, opened_foxglove(settings["foxglove"]) as foxglove:
        flights = Flights(stop, view, foxglove, quiet=quiet)
        while True:
            session, watch = _run(settings, overrides, instance, flights)
            again = watch.run_end is not None and watch.run_end.value == "again" and not stop
            if not again and (session.world.steering is None or not session.world.steering.reset):
                break
            _begin_anew(settings)
    to_the_end = settings["until"] == "complete"
    _conclude(session, watch, interrupted=stop.interrupted, to_the_end=to_the_end)


def _begin_anew(settings: "EffectiveSettings") -> None:
    """Run again after a reset; the log of the previous run is kept."""
    from pathlib import Path

    from autopilot.log.log_session import free_path

    if settings["log"] is not None:
        settings.put("log", str(free_path(Path(settings["log"]))), settings.table["log"].origin)


def _run(
    settings: "EffectiveSettings", overrides: dict[str, float], instance: int, flights: Flights
) -> "tuple[SitlSession, RunWatch]":
    """A run, from links to its end."""
    from autopilot.run.sitl_params import open_sitl_links, state_folder
    from autopilot.run.state_lock import locked_state

    def make(options: "SessionOptions") -> "SitlSession":
        from autopilot.run.sitl_session import open_sitl

        options["on_tick"] = lambda outputs: watch.step(outputs)
        return open_sitl(settings, overrides, instance=instance, **options)

    with (
        locked_state(state_folder(settings, instance)),
        flights.ready(lambda: open_sitl_links(settings, overrides, instance=instance), make) as (session, show),
    ):
        from autopilot.run.sitl_console import RunWatch

        watch = RunWatch(session, show)
        world, connections = session.world, ", ".join(settings["connect"])
        show(f"{world.scenario.scenario.name}: seed {world.seed}, speed {world.speed:g}, MAVLink on {connections}")
        to_the_end, steering = settings["until"] == "complete", session.world.steering
        try:
            wall_s = session.run(
                stop=lambda: (
                    bool(flights.stop)
                    or watch.run_end is not None
                    or (to_the_end and watch.ended)
                    or (steering is not None and steering.reset)
                )
            )
            counters = session.runtime.counters
            ran_s = counters.due * 0.01
            show(
                f"{ran_s:.1f} s simulated in {wall_s:.1f} s ({ran_s / max(wall_s, 1e-9):.1f} x real time), "
                f"{counters.overruns} overruns, longest tick {1e3 * counters.worst_tick_s:.0f} ms, "
                f"{watch.contacts} contact{'' if watch.contacts == 1 else 's'}"
            )
        finally:
            if steering is not None:
                steering.end()
            if flights.view is not None:
                flights.view.detach()
    return session, watch


def _conclude(session: "SitlSession", watch: "RunWatch", *, interrupted: bool, to_the_end: bool) -> None:
    """Warnings on stderr, and the exit code."""
    not_whole = tell_losses(session)
    if watch.contacts:
        click.echo(f"warning: {watch.contacts} contacts with walls, floor or obstacles", err=True)
    if interrupted:
        raise click.Abort
    if to_the_end and not watch.complete and watch.run_end is None:
        raise AutopilotError("the run ended before its mission was complete; look at the messages above, or at /rosout")
    if not_whole or watch.contacts:
        click.get_current_context().exit(EXIT_LOSS)
