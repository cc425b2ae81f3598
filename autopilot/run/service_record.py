"""The record of how a service was made, for its log, and the service that is made from such a record."""

from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec
import numpy as np

from autopilot.command.map_check import MapCheck, open_map
from autopilot.command.parts import Parts
from autopilot.command.service import Autopilot
from autopilot.control.water.current_learning import Basin, LearnedCurrent
from autopilot.control.water.current_map import CurrentMap
from autopilot.control.water.currents import CurrentForecast, EstimatedCurrent, MappedCurrent, NoCurrent
from autopilot.core.desk import Desk
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.geodesy import Origin
from autopilot.core.params import ParamSet, Saved
from autopilot.core.plan import PlanKind
from autopilot.core.witness import Recalled
from autopilot.log.reader import Log
from autopilot.log.shelf import LogShelf
from autopilot.mavlink.api import SigningState
from autopilot.replay.service_record import (
    CURRENTS_FILE,
    SERVICE_FILE,
    START_PLANS_FILE,
    CurrentsRecord,
    ServiceRecord,
    SigningRecord,
    read_record,
)
from autopilot.replay.setup import read_markers, read_setup, read_vehicle
from autopilot.run.compose import ServiceSetup, build_service
from autopilot.run.kept_plans import PLANS_KEPT
from autopilot.run.plans_format import Snapshot, decode, encode, plan_item

PLACEHOLDER_KEY = b"\xa5" * 32
"""Stands for a key that is in no log."""


def service_attachments(
    setup: ServiceSetup, parts: Parts, *, currents: str, basin: str, map_file: Path | None, map_start: str | None
) -> dict[str, bytes]:
    """All that is needed to make that service again, as it is before its first tick.

    ``currents``, ``basin``: what it is told of the water; ``map_file``: of the current, None without one.
    """
    signing = None if setup.signing is None else setup.signing.state
    record = ServiceRecord(
        profile=setup.profile,
        instance=setup.instance,
        controller=setup.controller,
        estimator=setup.estimator,
        origin=(setup.origin.lat_deg, setup.origin.lon_deg, setup.origin.alt_m),
        floor_depth_m=setup.floor_depth_m,
        currents=CurrentsRecord(
            kind=currents,
            basin=basin,
            map_suffix="" if map_file is None else map_file.suffix,
            map_start_utc=map_start,
        ),
        links=setup.links,
        rates={str(link): rate for link, rate in setup.rates.items()},
        patience=setup.patience,
        waits_for_plans=setup.waits_for_plans,
        saving=setup.saving is not None,
        shelf=setup.shelf is not None,
        pictures=setup.pictures,
        signing=None if signing is None else SigningRecord(key=signing.key is not None, stamp=signing.stamp),
        parameters=dict(setup.params),
        git=setup.git,
    )
    plans = parts.plans
    start = Snapshot(
        configured_origin=setup.origin,
        origin=plans.origin,
        home_ned_m=plans.home_ned_m,
        items={kind: plans.items(kind) for kind in PlanKind},
        position=parts.commander.mission_position,
    )
    return {
        SERVICE_FILE: msgspec.json.encode(record),
        START_PLANS_FILE: encode(start),
        **({} if map_file is None else {CURRENTS_FILE: map_file.read_bytes()}),
    }


def service_again(
    log: Log,
    *,
    witness: Recalled,
    formula: Callable[[Log], CurrentForecast],
    folder: Path,
    changes: Iterable[tuple[str, float]] = (),
) -> tuple[Autopilot, Parts]:
    """The service of a log as it was before its first tick, with some parameters changed.

    ``witness`` gives the answers of then, ``formula`` the current that a controller was told without a file, ``folder``
    is for files of this call. LogError if the log does not say enough; ConfigError for a parameter that there is not.
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
    water = _water(log, record, origin, folder)
    signing = record.signing
    store = None if signing is None else _Store(PLACEHOLDER_KEY if signing.key else None, signing.stamp)
    shelf = LogShelf(folder / "none", Desk()) if record.shelf else None
    setup = ServiceSetup(
        vehicle=read_vehicle(log),
        params=params,
        origin=origin,
        markers=read_markers(log.attachments),
        floor_depth_m=record.floor_depth_m,
        estimator=record.estimator,
        estimator_asked_by=f"{log.path}: {SERVICE_FILE}",
        controller=record.controller,
        controller_asked_by=f"{log.path}: {SERVICE_FILE}",
        profile=record.profile,
        instance=record.instance,
        currents=_forecast(log, record, water, formula),
        water=None if water is None else MapCheck(water, origin),
        links=record.links,
        rates={int(link): rate for link, rate in record.rates.items()},
        patience=record.patience,
        saving=_Saving() if record.saving else None,
        signing=store,
        shelf=shelf,
        pictures=record.pictures,
        waits_for_plans=record.waits_for_plans,
        git=record.git,
        witness=witness,
    )
    read_setup(log)  # named now if it is damaged
    service, parts = build_service(setup)
    _take_plans(log, parts, witness)
    return service, parts


def _water(log: Log, record: ServiceRecord, origin: Origin, folder: Path) -> CurrentMap | None:
    if not record.currents.map_suffix:
        return None
    data = log.attachments.get(CURRENTS_FILE)
    if data is None:
        raise LogError(f"{log.path}: has no attachment {CURRENTS_FILE}; the log is damaged")
    path = folder / f"{CURRENTS_FILE}{record.currents.map_suffix}"
    path.write_bytes(data)
    return open_map(path, origin, record.currents.map_start_utc)


def _forecast(
    log: Log, record: ServiceRecord, water: CurrentMap | None, formula: Callable[[Log], CurrentForecast]
) -> CurrentForecast:
    match record.currents.kind:
        case "map":
            return formula(log) if water is None else MappedCurrent(water)
        case "none":
            return NoCurrent()
        case "uniform":
            return EstimatedCurrent()
        case _:
            return LearnedCurrent(Basin(record.currents.basin))


def _take_plans(log: Log, parts: Parts, witness: Recalled) -> None:
    """Plans, origin, home and place in the mission as they were before the first tick."""
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
    plans.keeper = lambda: witness.ask(PLANS_KEPT, True, lambda: True)


class _Saving:
    """Nothing is written; what became of it then, the witness knows."""

    def save(self, tick: int, name: str) -> int | None:
        """Never asked: the witness answers."""
        raise AssertionError("a replay asks its log")

    def saved(self, tick: int) -> Saved | None:
        """Never asked: the witness answers."""
        raise AssertionError("a replay asks its log")


class _Store:
    """The same for the signing key."""

    def __init__(self, key: bytes | None, stamp: int) -> None:
        self.state = SigningState(key, stamp)

    def keep(self, tick: int, state: SigningState) -> None:
        """Nothing is written."""

    def poll(self, tick: int) -> Saved | None:
        """Never asked: the witness answers."""
        raise AssertionError("a replay asks its log")
