"""The record of how a service was made, for its log (:mod:`autopilot.replay.again` makes it once more)."""

import msgspec

from autopilot.command.service_parts import Parts
from autopilot.core.plan import PlanKind
from autopilot.record.service_setup import (
    CURRENTS_FILE,
    SERVICE_FILE,
    START_PLANS_FILE,
    CurrentsRecord,
    ServiceRecord,
    SigningRecord,
)
from autopilot.run.compose import ServiceSetup
from autopilot.run.plans_format import PlansSnapshot, encode
from autopilot.run.world import WaterTold


def service_attachments(setup: ServiceSetup, parts: Parts, water: WaterTold) -> dict[str, bytes]:
    """All that is needed to make that service again, as it is before its first tick."""
    signing = None if setup.signing is None else setup.signing.state
    record = ServiceRecord(
        profile=setup.profile,
        instance=setup.instance,
        controller=setup.controller,
        estimator=setup.estimator,
        origin=(setup.origin.lat_deg, setup.origin.lon_deg, setup.origin.alt_m),
        floor_depth_m=setup.floor_depth_m,
        currents=CurrentsRecord(
            kind=water.kind,
            basin=water.basin,
            map_suffix="" if water.map_file is None else water.map_file.suffix,
            map_start_utc=water.map_start,
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
    start = PlansSnapshot(
        configured_origin=setup.origin,
        origin=plans.origin,
        home_ned_m=plans.home_ned_m,
        items={kind: plans.items(kind) for kind in PlanKind},
        position=parts.commander.mission_position,
    )
    return {
        SERVICE_FILE: msgspec.json.encode(record),
        START_PLANS_FILE: encode(start),
        **({} if water.map_file is None else {CURRENTS_FILE: water.map_file.read_bytes()}),
    }
