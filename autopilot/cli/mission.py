"""``autopilot mission``: plans to and from a vehicle, over our own small MAVLink client."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.click_types import FiniteRange
from autopilot.cli.completion import VEHICLE_NAME
from autopilot.cli.console_output import EXIT_FAILED, EXIT_LOSS, emit_json, print_table, progress_bar
from autopilot.cli.mission_new import new
from autopilot.cli.shared_options import JSON
from autopilot.core.errors import AutopilotError, PlanError

if TYPE_CHECKING:
    from autopilot.client.client_session import MissionStatus, VehicleConnection
    from autopilot.client.texts import VehicleText
    from autopilot.core.plan import PlanKind
    from autopilot.mission.plan_model import PlanFile

DEFAULT_CONNECTION = "udpout:127.0.0.1:14540"
"""Where a simulated vehicle listens for clients."""

_connect = click.option(
    "--connect",
    "connection",
    default=DEFAULT_CONNECTION,
    show_default=True,
    metavar="CONN",
    help="Where the vehicle is: udpout:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT.",
)
_patience = click.option(
    "--patience",
    type=FiniteRange(min=0.0),
    default=10.0,
    show_default=True,
    metavar="S",
    help="Wait so long for the vehicle's heartbeat.",
)


@click.group()
def mission() -> None:
    """Upload, download, start or check a plan (.plan, .waypoints, local-metres .toml)."""


@mission.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--clear", is_flag=True, help="Remove the vehicle's old plans first (when they conflict with the fence).")
@_connect
@_patience
@JSON
def upload(file: Path, clear: bool, connection: str, patience: float, as_json: bool) -> None:
    """Send FILE's fence, rally points and mission to the vehicle.

    Exit code 1: refused, the vehicle keeps what it had. 3: stored, but mission, fence and rally points do not fit each
    other, and the vehicle does not fly before that is mended.
    """
    from autopilot.mission.plan_files import read_plan

    plan = read_plan(file)
    with vehicle_session(connection, patience, as_json) as session:
        counts = _upload(session, plan, file, clear, quiet=as_json)
        _warn_of_size(plan, quiet=as_json)
        problem = session.plan_problem()
        if as_json:
            emit_json({"vehicle": _vehicle(session), **counts, "problem": problem})
        else:
            click.echo("accepted: " + ", ".join(f"{name} {count} items" for name, count in counts.items()))
    if problem:
        click.echo(f"stored, but the vehicle neither arms nor starts: {problem}", err=True)
        raise click.exceptions.Exit(EXIT_LOSS)


@mission.command()
@click.argument("file", type=click.Path(path_type=Path))
@_connect
@_patience
@JSON
def download(file: Path, connection: str, patience: float, as_json: bool) -> None:
    """Read the vehicle's plans and write them to FILE (.plan)."""
    from autopilot.core.plan import PlanKind
    from autopilot.mission.plan_files import PlanFile, write_plan

    with vehicle_session(connection, patience, as_json) as session:
        plans = {}
        for kind in PlanKind:
            with _bar(kind.name.lower(), quiet=as_json) as advance:
                plans[kind] = session.download(kind, advance)
        plan = PlanFile(
            mission=plans[PlanKind.MISSION], fence=plans[PlanKind.FENCE], rally=plans[PlanKind.RALLY], home=None
        )
        write_plan(file, plan)
        counts = {kind.name.lower(): len(items) for kind, items in plans.items()}
        if as_json:
            emit_json({"vehicle": _vehicle(session), "file": str(file), **counts})
        else:
            click.echo(f"{file}: " + ", ".join(f"{name} {count} items" for name, count in counts.items()))


@mission.command()
@click.argument("file", type=click.Path(path_type=Path), required=False)
@click.option("--clear", is_flag=True, help="Remove the vehicle's old plans before FILE is sent.")
@click.option("--wait", is_flag=True, help="Watch the mission until it is complete.")
@click.option(
    "--timeout",
    type=FiniteRange(min=0.0),
    default=3600.0,
    show_default=True,
    metavar="S",
    help="Longest vehicle time to watch.",
)
@_connect
@_patience
@JSON
def start(
    file: Path | None, clear: bool, wait: bool, timeout: float, connection: str, patience: float, as_json: bool
) -> None:
    """Arm the vehicle and start its mission, after sending FILE if one is given."""
    from autopilot.core.messages import ProgressState
    from autopilot.mission.plan_files import read_plan

    plan = None if file is None else read_plan(file)
    with vehicle_session(connection, patience, as_json) as session:
        if plan is not None and file is not None:
            _upload(session, plan, file, clear, quiet=as_json)
        with once_each(session):
            _arm_and_start(session)
        if not wait:
            if as_json:
                emit_json({"vehicle": _vehicle(session), "started": True})
            else:
                click.echo("mission started")
            return
        status = session.watch_mission(None if as_json else MissionLines(), timeout)
    complete = status.state is ProgressState.COMPLETE
    if as_json:
        emit_json({"state": status.state.name, "seq": status.seq, "total": status.total, "reached": status.reached})
    else:
        click.echo(f"mission {status.state.name.lower()}: {len(status.reached)} items reached")
    if not complete:
        raise click.exceptions.Exit(EXIT_FAILED)


@mission.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--vehicle",
    type=VEHICLE_NAME,
    default="lbv150",
    show_default=True,
    help="Vehicle file or shipped vehicle, for its radius.",
)
@click.option("--param", "overrides", multiple=True, metavar="NAME=VALUE", help="Judge with another parameter value.")
@JSON
def check(file: Path, vehicle: str, overrides: tuple[str, ...], as_json: bool) -> None:
    """Show everything that is wrong with FILE, without a vehicle.

    Exit code 1: a vehicle would refuse it. 3: it would be stored, but could not be flown.
    """
    from autopilot.core.item_numbers import counted
    from autopilot.core.params import ParamSet
    from autopilot.core.plan import PlanKind
    from autopilot.core.vehicle import load_vehicle
    from autopilot.mission.plan_files import read_plan
    from autopilot.run.config import parse_overrides
    from autopilot.run.plan_verdict import verdict_of

    params = ParamSet(parse_overrides(overrides))
    plan = read_plan(file)
    verdict = verdict_of(plan, plan.drawing_origin(), params, load_vehicle(vehicle))
    problems = [(p, "refused") for p in verdict.own] + [(p, "not flown") for p in verdict.joint]
    counts = {kind.name.lower(): len(plan.items(kind)) for kind in PlanKind}
    warning = _warn_of_size(plan, quiet=as_json)
    if as_json:
        found = [
            {"plan": p.kind.name.lower(), "item": p.seq, "result": p.result.name, "means": means, "reason": p.reason}
            for p, means in problems
        ]
        emit_json({"file": str(file), "ok": not found, "items": counts, "problems": found, "warning": warning})
    elif problems:
        ahead = 0 if plan.mission and plan.mission[0].is_home else 1
        rows = [
            (p.kind.name.lower(), p.seq, p.result.name, means, counted(p.reason, ahead=ahead)) for p, means in problems
        ]
        print_table(f"{file}: {len(problems)} problems", ("plan", "item", "result", "means", "what is wrong"), rows)
    else:
        click.echo(f"{file}: fit to fly: " + ", ".join(f"{name} {count} items" for name, count in counts.items()))
    if problems:
        raise click.exceptions.Exit(1 if verdict.own else EXIT_LOSS)


mission.add_command(new)


@contextmanager
def vehicle_session(connection: str, patience_s: float, quiet: bool) -> Iterator[VehicleConnection]:
    """Connection to a vehicle whose heartbeat has arrived; warnings of the vehicle go to stderr."""
    from autopilot.client.client_session import VehicleConnection
    from autopilot.client.texts import WARNING
    from autopilot.core.phrases import NO_START

    with VehicleConnection(connection) as session:
        if not quiet:
            session.on_text = lambda text: (
                click.echo(f"vehicle: {text.text}", err=True)
                if text.severity <= WARNING and not text.text.startswith(NO_START)
                else None
            )
        session.connect(patience_s)
        yield session


@contextmanager
def once_each(session: VehicleConnection) -> Iterator[None]:
    """Filters the text of a refusal, which is in the error message too."""
    show = session.on_text
    held: list[VehicleText] = []
    if show is None:
        yield
        return
    session.on_text = held.append
    try:
        yield
    except AutopilotError as error:
        held = [text for text in held if text.text not in str(error)]
        raise
    finally:
        session.on_text = show
        for text in held:
            show(text)


def _arm_and_start(session: VehicleConnection) -> None:
    """A vehicle that is armed here and then refuses is not left with its thrusters turning."""
    armed_here = session.vehicle is None or not session.vehicle.armed
    if armed_here:
        session.arm()
    try:
        session.start_mission()
    except AutopilotError:
        if armed_here:
            try:
                session.disarm()
                click.echo("not started: disarmed again", err=True)
            except AutopilotError as error:
                click.echo(f"not started, and not known to be disarmed: {error}", err=True)
        raise


def _upload(session: VehicleConnection, plan: PlanFile, file: Path, clear: bool, quiet: bool) -> dict[str, int]:
    """Fence, rally points, mission, so that the last word of the vehicle is about all. A .waypoints file holds a
    mission only."""
    from autopilot.core.plan import PlanKind

    kinds: tuple[PlanKind, ...] = (PlanKind.FENCE, PlanKind.RALLY, PlanKind.MISSION)
    if file.suffix.lower() in (".waypoints", ".txt"):
        kinds = (PlanKind.MISSION,)
    if clear and session.vehicle is not None and session.vehicle.armed:
        raise PlanError("--clear denied: the armed vehicle would be left without plans; disarm it, or send without")
    if clear:
        for kind in reversed(kinds):
            with once_each(session):
                session.upload(kind, ())
    for kind in kinds:
        with once_each(session), _bar(kind.name.lower(), quiet) as advance:
            session.upload(kind, plan.items(kind), advance)
    return {kind.name.lower(): len(plan.items(kind)) for kind in kinds}


def _warn_of_size(plan: PlanFile, quiet: bool) -> str:
    """Warn of a large mission without a fence, as the vehicle does; the text, "" if there is nothing to say."""
    from autopilot.core.operator_messages import MISSION_UNFENCED
    from autopilot.mission.extent import unfenced_extent

    extent = unfenced_extent(plan.mission, plan.fence, plan.drawing_origin())
    if extent is None:
        return ""
    text = MISSION_UNFENCED(size=extent.text).text
    if not quiet:
        click.echo(f"warning: {text}", err=True)
    return text


def _vehicle(session: VehicleConnection) -> dict[str, int] | None:
    vehicle = session.vehicle
    return None if vehicle is None else {"system": vehicle.system, "autopilot": vehicle.autopilot}


@contextmanager
def _bar(name: str, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Progress bar of an exchange, if any."""
    with progress_bar("{task.description:8}", transient=True, quiet=quiet) as bar:
        if bar is None:
            yield None
            return
        task = bar.add_task(name, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


class MissionLines:
    """One line per event of the mission."""

    def __init__(self) -> None:
        self._reached = 0
        self._state = ""

    def __call__(self, status: MissionStatus) -> None:
        if status.state and status.state.name != self._state:
            self._state = status.state.name
            click.echo(f"mission {self._state.lower().replace('_', ' ')}, {status.total} items", err=True)
        for seq in status.reached[self._reached :]:
            click.echo(f"reached item {seq}", err=True)
        self._reached = len(status.reached)
