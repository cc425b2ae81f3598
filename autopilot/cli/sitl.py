"""``autopilot sitl``: the service on a simulated vehicle."""

import time
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.finite import FiniteRange
from autopilot.cli.output import EXIT_LOSS
from autopilot.cli.part_name import part_name
from autopilot.cli.service_run import StopSignals, settle_memory, tell_losses
from autopilot.cli.view_option import foxglove_option, opened_foxglove, opened_view, view_option
from autopilot.core.errors import AutopilotError
from autopilot.run.config import BASINS, CURRENTS, PROFILES, SENSORS, UNTIL, WIRES
from autopilot.run.process_start import process_start_s

if TYPE_CHECKING:
    from autopilot.run.config import Settings
    from autopilot.run.sitl_console import RunWatch
    from autopilot.run.sitl_session import SitlSession
    from autopilot.view.foxglove import FoxgloveServer
    from autopilot.view.hub import Hub


@click.command()
@click.argument("scenario", required=False)
@click.option("--vehicle", help="Another vehicle than the scenario's: a shipped name or a vehicle file.")
@click.option("--plan", type=click.Path(exists=True, dir_okay=False), help="Preload mission, fence and rally.")
@click.option("--speed", type=FiniteRange(min=0.0), help="1 = real time (default), 0 = as fast as possible.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of all randomness (default: the scenario's).")
@click.option("--duration", type=FiniteRange(min=0.0, min_open=True), help="End after so many seconds.")
@click.option("--log", type=click.Path(dir_okay=False), help="Log file (default: one per arming in the log folder).")
@click.option("--log-camera-hz", type=FiniteRange(0.0, 100.0), help="Pictures in the log per second (default 2).")
@click.option("--connect", multiple=True, help="MAVLink connection; repeatable, replaces the defaults.")
@click.option("--controller", callback=part_name, help="Default: the scenario's, else nmpc.")
@click.option("--estimator", callback=part_name, help="ekf, complementary (default: the scenario's, else ekf).")
@click.option("--plant", callback=part_name, help="Default: the scenario's, else rigid-body.")
@click.option("--sensors", type=click.Choice(SENSORS), help="Rendered camera, or a noisy pose (default: scenario's).")
@click.option(
    "--hil",
    multiple=True,
    type=click.Choice(WIRES),
    help="Through real drivers and wires; repeatable: AHRS on a serial line, camera as a network stream, PWM board.",
)
@click.option("--markers", type=click.Path(dir_okay=False), help="Marker map that it is told (default: the true one).")
@click.option(
    "--currents", type=click.Choice(CURRENTS), help="What the controller knows of them (default: scenario's)."
)
@click.option(
    "--basin", type=click.Choice(BASINS), help="Whether what flows comes back within the fence (default: scenario's)."
)
@click.option("--currents-map", type=click.Path(dir_okay=False), help="Current map (.npz, NetCDF): --currents map.")
@click.option("--currents-start", metavar="UTC", help="Date of the start in the map (default: its first frame).")
@click.option("--param", multiple=True, metavar="NAME=VALUE", help="Set a parameter for this run; repeatable.")
@click.option("--profile", type=click.Choice(PROFILES), help="MAVLink identity (default: px4).")
@click.option("--instance", type=click.IntRange(0, 99), default=0, show_default=True, help="Instance number.")
@click.option("--start", is_flag=True, default=None, help="Arm and start the preloaded plan by an operator in-process.")
@click.option("--keep-plans", is_flag=True, default=None, help="Keep plans, fence, home and progress between runs.")
@click.option("--until", type=click.Choice(UNTIL), help="End with the mission; exit code 1 if it ends otherwise.")
@view_option
@foxglove_option
@click.option("--quiet", is_flag=True, help="Print only errors.")
def sitl(scenario: str | None, param: tuple[str, ...], instance: int, quiet: bool, **given: Any) -> None:
    """Run the service on the simulated vehicle of SCENARIO (a shipped name or a TOML file; default paper-tank)."""
    from autopilot.run.config import gather, parse_overrides, sitl_defaults

    settings = gather(sitl_defaults(instance), {"scenario": scenario, **given})
    stop, began_s = StopSignals(), process_start_s()
    overrides = parse_overrides(param)
    with opened_view(settings["view"]) as view, opened_foxglove(settings["foxglove"]) as foxglove:
        while True:
            session, watch = _run(settings, overrides, instance, stop, view, foxglove, began_s, quiet=quiet)
            began_s = time.time()
            again = watch.run_end is not None and watch.run_end.value == "again" and not stop
            if not again and (session.steering is None or not session.steering.reset):
                break
            _begin_anew(settings)
    to_the_end = settings["until"] == "complete"
    _conclude(session, watch, interrupted=stop.interrupted, to_the_end=to_the_end)


def _begin_anew(settings: "Settings") -> None:
    """A run after one that was reset: what that one has recorded stays."""
    from pathlib import Path

    from autopilot.log.session import free_path

    if settings["log"] is not None:
        settings.put("log", str(free_path(Path(settings["log"]))), settings.table["log"].origin)


def _run(
    settings: "Settings",
    overrides: dict[str, float],
    instance: int,
    stop: StopSignals,
    view: "Hub | None",
    foxglove: "FoxgloveServer | None",
    began_s: float,
    *,
    quiet: bool,
) -> "tuple[SitlSession, RunWatch]":
    """A run, from links to its end."""
    from autopilot.run.sitl_params import open_sitl_links

    with open_sitl_links(settings, overrides, instance=instance) as boot:
        from autopilot.run.console import Console
        from autopilot.run.sitl_console import RunWatch
        from autopilot.run.sitl_session import open_sitl

        session = open_sitl(
            settings,
            overrides,
            instance=instance,
            links=boot.links,
            now_s=began_s,
            on_tick=lambda outputs: watch.step(outputs),
            view=view,
            foxglove=foxglove,
        )
        settle_memory()
    session.runtime.take_over(boot.take_unanswered())
    for warning in session.warnings:
        click.echo(f"warning: {warning}", err=True)
    console = None if quiet else Console()
    show = (lambda _: None) if console is None else console.print
    watch = RunWatch(session, show)
    world, connections = session.world, ", ".join(settings["connect"])
    show(f"{world.scenario.scenario.name}: seed {world.seed}, speed {world.speed:g}, MAVLink on {connections}")
    to_the_end, steering = settings["until"] == "complete", session.steering
    try:
        wall_s = session.run(
            stop=lambda: (
                bool(stop)
                or watch.run_end is not None
                or (to_the_end and watch.ended)
                or (steering is not None and steering.reset)
            )
        )
        counters = session.runtime.counters
        ran_s = counters.ticks * 0.01
        show(
            f"{ran_s:.1f} s simulated in {wall_s:.1f} s ({ran_s / max(wall_s, 1e-9):.1f} x real time), "
            f"{counters.overruns} overruns, longest tick {1e3 * counters.worst_tick_s:.0f} ms, "
            f"{watch.contacts} contact{'' if watch.contacts == 1 else 's'}"
        )
    finally:
        if console is not None:
            console.close()
        if steering is not None:
            steering.end()
        if view is not None:
            view.detach()
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
