"""``autopilot calibrate flight``: latency, extrinsics and laser from one log, or from a flight that it makes itself."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.click_types import Finite, FiniteRange
from autopilot.cli.completion import VEHICLE_NAME
from autopilot.cli.console_output import EXIT_LOSS, emit_json, print_table
from autopilot.cli.shared_options import JSON_NOT_TABLES
from autopilot.core.errors import AutopilotError, ConfigError, DriverError, LogError, PlanError

if TYPE_CHECKING:
    from autopilot.calibrate.whole_flight import FlightCalibration
    from autopilot.client.client_session import VehicleConnection
    from autopilot.core.plan import PlanItem

PATIENCE_S = 10.0
SURFACED_S = 120.0
"""Longest ascent at the end."""
CLOSED_S = 15.0
"""Longest wait for the end of a log; one that the service does not end is read as it is."""


@click.command()
@click.argument("log_file", metavar="[LOG]", required=False, type=click.Path(path_type=Path))
@click.option("--vehicle", type=VEHICLE_NAME, help="Vehicle (shipped name or file) instead of the log's own.")
@click.option("--map", "map_file", type=click.Path(path_type=Path), help="Marker map instead of the log's own.")
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Vehicle file to write (.toml)."
)
@click.option("--connect", "connection", metavar="CONN", help="Fly the manoeuvre; where the vehicle is, as `mission`.")
@click.option(
    "--log",
    "written",
    type=click.Path(path_type=Path),
    help="With --connect: the log that the service writes, or its folder of logs.",
)
@click.option(
    "--floor", type=Finite(), metavar="M", help="With --connect: depth of the floor (default: by map or laser)."
)
@click.option("--laps", type=click.IntRange(1, 20), default=2, show_default=True, help="How often it is flown.")
@click.option("--yes", is_flag=True, help="With --connect: arm and start without asking.")
@click.option(
    "--timeout", type=FiniteRange(min=0.0), default=900.0, show_default=True, metavar="S", help="Longest flight."
)
@JSON_NOT_TABLES
@click.pass_context
def flight(
    ctx: click.Context,
    log_file: Path | None,
    vehicle: str | None,
    map_file: Path | None,
    out: Path,
    connection: str | None,
    written: Path | None,
    floor: float | None,
    laps: int,
    yes: bool,
    timeout: float,
    as_json: bool,
) -> None:
    """Stamps, place and turn of the camera, and the laser's beam, from one flight over markers.

    Either from LOG, or with --connect from a flight that is made for the fence in force. Exit code 1: nothing was found
    or written. 3: a step found nothing and leaves its keys as they were.
    """
    from autopilot.calibrate.whole_flight import calibrate_flight
    from autopilot.core.disk import write_result

    if (log_file is None) == (connection is None):
        raise click.UsageError("give either LOG, or --connect and --log to fly the manoeuvre")
    if connection is not None:
        if written is None:
            raise click.UsageError("--connect: name by --log the file that the service logs to, or its folder of logs")
        places = vehicle, map_file, floor, laps
        log_file = _fly(connection, written, *places, yes=yes, timeout_s=timeout, quiet=as_json)
    assert log_file is not None
    found = calibrate_flight(log_file, vehicle, map_file)
    if found.steps:
        write_result(out, found.text)
    if as_json:
        emit_json(_facts(log_file, found))
    else:
        _print(log_file, out, found)
    if not found.steps:
        raise LogError(f"{log_file}: no step succeeded; nothing is written")
    ctx.exit(EXIT_LOSS if found.failed else 0)


def _facts(log_file: Path, found: FlightCalibration) -> dict[str, object]:
    return {
        "log": str(log_file),
        "found": [{"step": step.name, **asdict(row)} for step in found.steps for row in step.findings],
        "kept": [{"what": what, "shown_by": by} for step in found.steps for what, by in step.kept],
        "failed": [{"step": name, "reason": reason} for name, reason in found.failed],
        "keys": {key: value for step in found.steps for key, value in step.keys.items()},
    }


def _print(log_file: Path, out: Path, found: FlightCalibration) -> None:
    rows = [
        (row.name, f"{row.value:.3f}", f"{row.sigma:.3f}", row.unit, f"{row.before:.3f}")
        for step in found.steps
        for row in step.findings
    ]
    if rows:
        print_table(str(log_file), ("", "value", "sigma", "unit", "before"), rows)
    kept = [row for step in found.steps for row in step.kept] + list(found.failed)
    if kept:
        print_table("Not seen in this flight, kept as it was", ("", "what would show it"), kept)
    if found.steps:
        keys = ", ".join(key for step in found.steps for key in step.keys)
        click.echo(f"{out}: {found.flight.vehicle.name} with {keys}")


def _fly(
    connection: str,
    log: Path,
    vehicle: str | None,
    map_file: Path | None,
    floor_m: float | None,
    laps: int,
    *,
    yes: bool,
    timeout_s: float,
    quiet: bool,
) -> Path:
    """Fly the manoeuvre; the result is its log. The vehicle's mission is put back, however the flight ends."""
    from autopilot.cli.mission import MissionLines, once_each, vehicle_session
    from autopilot.core.messages import ProgressState
    from autopilot.core.plan import PlanKind

    if not log.exists():
        raise ConfigError(f"--log {log}: is not there; name the file that the service logs to, or its folder of logs")
    with vehicle_session(connection, PATIENCE_S, quiet) as session:
        if session.vehicle is not None and session.vehicle.armed:
            raise ConfigError("the vehicle is armed; let it end what it does and disarm it")
        before = session.download(PlanKind.MISSION)
        items = _manoeuvre(session, vehicle, map_file, floor_m, laps)
        if not yes:
            question = f"The vehicle will arm and fly {len(items)} items within its fence. Start?"
            click.confirm(question, abort=True, err=True)
        since_s = time.time()
        with _stoppable(), _put_back(session, before):
            with once_each(session):
                session.upload(PlanKind.MISSION, items)
                problem = session.plan_problem()
                if problem:
                    raise PlanError(f"the vehicle does not fly the manoeuvre: {problem}")
                session.arm()
                session.start_mission()
            status = session.watch_mission(None if quiet else MissionLines(), timeout_s)
            # At its last item the vehicle surfaces, and may be disarmed before it tells that the mission is complete.
            at_last = 0 < status.total <= status.seq + 1
            if status.state is not ProgressState.COMPLETE and not at_last:
                raise DriverError(f"the flight ended at item {status.seq} of {status.total}; nothing is calibrated")
            session.wait_disarmed(SURFACED_S)
    found = _closed_log(log, since_s)
    click.echo(f"the flight is in {found}", err=True)
    return found


def _manoeuvre(
    session: VehicleConnection, vehicle: str | None, map_file: Path | None, floor_m: float | None, laps: int
) -> tuple[PlanItem, ...]:
    """The mission for the fence, the depth band and the floor that the vehicle has."""
    import numpy as np
    from pymavlink.dialects.v20 import development as mav

    from autopilot.core.geodesy import Origin
    from autopilot.core.marker_files import load_marker_map
    from autopilot.core.plan import PlanKind
    from autopilot.core.vehicle import load_vehicle
    from autopilot.mission.calibration_mission import CALIBRATION_PARAMETERS, calibration_mission

    fence = session.download(PlanKind.FENCE)
    params = {name: session.parameter(name) for name in CALIBRATION_PARAMETERS}
    place = session.message(mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
    if map_file is not None:
        markers = load_marker_map(map_file)
        near = markers.centers_ned_m[:, :2].mean(axis=0)
        floor_m = markers.floor_m if floor_m is None else floor_m
    else:
        here = session.message(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
        near = np.array([here.x, here.y])
        try:
            if floor_m is None:
                floor_m = here.z + 0.01 * session.message(mav.MAVLINK_MSG_ID_DISTANCE_SENSOR).current_distance
        except AutopilotError as error:
            raise ConfigError("the vehicle does not measure the floor; give its depth by --map or --floor") from error
    return calibration_mission(
        fence,
        Origin(lat_deg=1e-7 * place.latitude, lon_deg=1e-7 * place.longitude, alt_m=1e-3 * place.altitude),
        params,
        radius_m=load_vehicle(vehicle or "lbv150").radius_m,
        floor_m=floor_m,
        near_ned_m=near,
        laps=laps,
    )


@contextmanager
def _stoppable() -> Iterator[None]:
    """SIGTERM ends the flight as Ctrl-C does."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _put_back(session: VehicleConnection, before: tuple[PlanItem, ...]) -> Iterator[None]:
    """Puts the vehicle's own mission back; a vehicle whose flight is broken off holds where it is."""
    from pymavlink.dialects.v20 import development as mav

    from autopilot.core.plan import PlanKind

    try:
        yield
    except BaseException:
        if session.vehicle is not None and session.vehicle.armed:
            click.echo("stopped: the vehicle holds, armed", err=True)
            try:
                session.command(mav.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
            except AutopilotError as error:
                click.echo(f"warning: {error}; take over by the remote control", err=True)
        raise
    finally:
        try:
            session.upload(PlanKind.MISSION, before)
        except AutopilotError as error:
            click.echo(f"warning: the mission from before could not be put back: {error}", err=True)


def _closed_log(place: Path, since_s: float) -> Path:
    """The log of this flight, when it has been ended. LogError if there is none."""
    from autopilot.log.reader import open_log

    end_s = time.monotonic() + CLOSED_S
    while True:
        files = [f for f in (place, *place.rglob("*.mcap")) if f.is_file() and f.stat().st_mtime >= since_s]
        newest = max(files, key=lambda file: file.stat().st_mtime, default=None)
        late = time.monotonic() > end_s
        if newest is None and late:
            raise LogError(f"--log {place}: holds no log of this flight; name what the service logs to")
        with suppress(LogError):
            if newest is not None and (late or not open_log(newest).problems):
                return newest
        time.sleep(0.5)
