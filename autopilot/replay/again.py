"""Rebuilds the service from the record in its log."""

from collections.abc import Iterable
from pathlib import Path

import msgspec
import numpy as np

from autopilot.command.map_check import MapCheck, open_map
from autopilot.command.service import Autopilot
from autopilot.command.service_parts import ServiceParts
from autopilot.control.current.current_map import CurrentMap
from autopilot.control.current.currents import CurrentForecast, MappedCurrent
from autopilot.core.background import BackgroundWorker
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.geodesy import Origin
from autopilot.core.nondeterminism import NondeterminismReplay
from autopilot.core.params import ParamSet, Saved
from autopilot.core.plan import PlanKind
from autopilot.log.directory_reader import LogDirectoryReader
from autopilot.log.reader import Log
from autopilot.mavlink.api import SigningState
from autopilot.record.estimator_setup import read_markers, read_setup, read_vehicle
from autopilot.record.service_setup import (
    CURRENTS_FILE,
    SAME,
    SERVICE_FILE,
    START_PLANS_FILE,
    ServiceRecord,
    read_record,
)
from autopilot.run.compose import ServiceSetup, build_service, forecast_of
from autopilot.run.kept_plans import PLANS_KEPT
from autopilot.run.plans_format import decode, plan_item
from autopilot.run.sitl_world import formula
from autopilot.sitl.scenario_tables import Scenario

PLACEHOLDER_KEY = b"\xa5" * 32
"""Stands for a key that is in no log."""


def service_again(
    log: Log,
    *,
    nondeterminism: NondeterminismReplay,
    folder: Path,
    changes: Iterable[tuple[str, float]] = (),
) -> tuple[Autopilot, ServiceParts]:
    """Service of a log in its state before the first tick, with changed parameters. ``witness`` replays recorded
    results, ``folder`` is for temporary files. LogError if the log lacks data; ConfigError for an unknown
    parameter.
    """
    record = read_record(log)
    params = ParamSet()
    for name, value in (*record.parameters.items(), *changes):
        try:
            params.set(name, value)
        except ConfigError as error:
            raise LogError(f"{log.path}: {error}; replay it with the version that has written it") from error
    lat, lon, alt = record.origin
    origin = Origin(lat_deg=lat, lon_deg=lon, alt_m=alt)
    current_map = _current_map(log, record, origin, folder)
    signing = record.signing
    store = None if signing is None else _Store(PLACEHOLDER_KEY if signing.key else None, signing.stamp)
    log_directory = LogDirectoryReader(folder / "none", BackgroundWorker()) if record.shelf else None
    setup = ServiceSetup(
        vehicle=read_vehicle(log),
        params=params,
        origin=origin,
        markers=read_markers(log.attachments),
        estimator_asked_by=f"{log.path}: {SERVICE_FILE}",
        controller_asked_by=f"{log.path}: {SERVICE_FILE}",
        currents=forecast_of(
            record.currents.kind,
            record.currents.basin,
            lambda: _formula(log) if current_map is None else MappedCurrent(current_map),
        ),
        current_check=None if current_map is None else MapCheck(current_map, origin),
        rates={int(link): rate for link, rate in record.rates.items()},
        saving=_Saving() if record.saving else None,
        signing=store,
        log_directory=log_directory,
        nondeterminism=nondeterminism,
        **{name: getattr(record, name) for name in SAME},
    )
    read_setup(log)  # named now if it is damaged
    service, parts = build_service(setup)
    _take_plans(log, parts, nondeterminism)
    return service, parts


def _current_map(log: Log, record: ServiceRecord, origin: Origin, folder: Path) -> CurrentMap | None:
    if not record.currents.map_suffix:
        return None
    data = log.attachments.get(CURRENTS_FILE)
    if data is None:
        raise LogError(f"{log.path}: has no attachment {CURRENTS_FILE}; the log is damaged")
    path = folder / f"{CURRENTS_FILE}{record.currents.map_suffix}"
    path.write_bytes(data)
    return open_map(path, origin, record.currents.map_start_utc)


def _formula(log: Log) -> CurrentForecast:
    """Analytic current of the scenario, for a controller that used no file."""
    data = log.attachments.get("scenario.json")
    if data is None:
        raise LogError(f"{log.path}: has no attachment scenario.json, whose current the controller was told")
    try:
        return formula(msgspec.json.decode(data, type=Scenario))
    except msgspec.MsgspecError as error:
        raise LogError(f"{log.path}: attachment scenario.json: {error}; the log is of another version") from error


def _take_plans(log: Log, parts: ServiceParts, nondeterminism: NondeterminismReplay) -> None:
    """Plans, origin, home and mission progress before the first tick."""
    data = log.attachments.get(START_PLANS_FILE)
    if data is None:
        raise LogError(f"{log.path}: has no attachment {START_PLANS_FILE}; the log is damaged")
    try:
        content = decode(data)
    except ValueError as error:
        raise LogError(f"{log.path}: attachment {START_PLANS_FILE} {error}") from error
    plans = parts.plans
    place = content.origin
    if (place.lat_deg, place.lon_deg, place.alt_m) != (plans.origin.lat_deg, plans.origin.lon_deg, plans.origin.alt_m):
        plans.set_origin(Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_m=place.alt_m))
    for kind, items in (
        (PlanKind.FENCE, content.fence),
        (PlanKind.MISSION, content.mission),
        (PlanKind.RALLY, content.rally),
    ):
        if items:
            plans.replace(kind, tuple(plan_item(item) for item in items))
    if any(content.home_ned_m):
        parts.commander.restore_home(np.array(content.home_ned_m))
    if content.position is not None and content.mission:
        parts.commander.stand_at(content.position)
    plans.watchdog = lambda: nondeterminism.observe(PLANS_KEPT, True, lambda: True)


class _Saving:
    """Writes nothing; results are replayed by the recorder."""

    def save(self, tick: int, name: str) -> int | None:
        """Never called: the recorder replays the answer."""
        raise AssertionError("a replay asks its log")

    def saved(self, tick: int) -> Saved | None:
        """Never called: the recorder replays the answer."""
        raise AssertionError("a replay asks its log")


class _Store:
    def __init__(self, key: bytes | None, stamp: int) -> None:
        self.state = SigningState(key, stamp)

    def keep(self, tick: int, state: SigningState) -> None: ...

    def poll(self, tick: int) -> Saved | None:
        """Never called: the recorder replays the answer."""
        raise AssertionError("a replay asks its log")
