"""Missions of files "QGC WPL 110" with a home row, as MAVProxy sends them: home is numbered, and not flown."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mission_world import MissionWorld
from pymavlink.dialects.v20 import development as mav

from autopilot.core.geodesy import geodetic_from_ned
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.plan_files import read_waypoints
from tests.plan_items import plain

ROW = "{}\t{}\t{}\t{}\t0\t0\t0\t{}\t{:.9f}\t{:.9f}\t{}\t1"


def afloat(profile: str) -> MissionWorld:
    world = type("Profiled", (MissionWorld,), {"profile": profile})((-1.2, 0.6, 0.5, 0.0))
    world.run(1.5)
    assert isinstance(world, MissionWorld)
    return world


def file_of(world: MissionWorld, altitudes: tuple[float, ...], home_alt: float = 0.0) -> str:
    """Home and waypoints 0.3 m apart, as MAVProxy saves them."""
    lines = ["QGC WPL 110"]
    for seq, alt in enumerate((home_alt, *altitudes)):
        lat, lon, _ = geodetic_from_ned(world.parts.plans.origin, np.array([-1.2 + 0.3 * seq, 0.6, 0.0]))
        lines.append(ROW.format(seq, int(seq == 0), 3 if seq else 0, 16, 0, lat, lon, alt))
    return "\n".join(lines) + "\n"


def wire(text: str) -> list[PlanItem]:
    """What MAVProxy sends of a file: every row, as it stands there."""
    return [replace(item, is_home=False) for item in read_waypoints(text, "f.waypoints").mission]


def downloaded(world: MissionWorld) -> list[Any]:
    (count,) = [m for m in world.ask(mav.MAVLink_mission_request_list_message(1, 1, 0)) if "COUNT" in m.get_type()]
    items = []
    for seq in range(count.count):
        items += world.ask(mav.MAVLink_mission_request_int_message(1, 1, seq, 0))
    return [m for m in items if m.get_type() == "MISSION_ITEM_INT"]


@pytest.mark.parametrize("profile", ["px4", "generic", "ardusub"])
def test_home_is_numbered_and_not_flown(profile: str) -> None:
    world = afloat(profile)
    items = [*wire(file_of(world, (-0.5, -0.5), home_alt=30.0)), plain(3, 177, 1.0, 1.0)]
    assert world.upload(items).type == 0, world.texts()
    assert "Mission plan accepted: 4 items, 0 is home" in world.texts()
    back = downloaded(world)
    assert [(m.seq, m.command) for m in back] == [(0, 16), (1, 16), (2, 16), (3, 177)]
    assert [(m.x, m.y, m.z) for m in back[1:]] == [(i.x, i.y, pytest.approx(i.z, nan_ok=True)) for i in items[1:]]
    assert back[3].param1 == 1.0
    world.arm()
    assert world.command(300, 0.0, 0.0) == 0
    world.inbox.clear()
    world.run(10.0)
    assert world.reached == [1, 2, 1, 2, 3]
    assert "Reached item 2" in world.texts()
    current = [m for m in world.inbox if m.get_type() == "MISSION_CURRENT"][-1]
    assert current.total == 3


@pytest.mark.parametrize("profile", ["px4", "generic", "ardusub"])
def test_refusals_have_the_numbers_of_the_file(profile: str) -> None:
    world = afloat(profile)
    assert world.upload(wire(file_of(world, (-0.5, 0.4)))).type == 12
    shown = (lambda seq: f"item {seq}") if profile == "ardusub" else (lambda seq: f"item {seq} (QGC {seq + 1})")
    assert f"{shown(2)}: 0.40 m above the surface" in world.texts()
    assert world.upload(wire(file_of(world, (-0.5, -2.5)))).type == 12
    assert f"{shown(2)}: depth 2.50 m" in world.texts()
    outside = wire(file_of(world, (-0.5, -0.5, -0.5)))
    outside[3] = replace(outside[3], y=outside[3].y + 1000)
    assert world.upload(outside).type == 0
    world.run(0.3)
    assert f"No start: {shown(3)} is" in world.texts()


@pytest.mark.parametrize("profile", ["px4", "generic"])
def test_a_first_waypoint_in_the_water_is_flown(profile: str) -> None:
    """An altitude above the sea at which the vehicle may be is a place, not home; so is one alone."""
    world = afloat(profile)
    assert world.upload(wire(file_of(world, (-0.5, -0.5), home_alt=-0.5))).type == 0
    assert not world.parts.plans.items(PlanKind.MISSION)[0].is_home
    assert world.upload(wire(file_of(world, (-0.5,), home_alt=30.0))[:1]).type == 12
    assert "item 0 (QGC 1): 30.00 m above the surface" in world.texts()
    amsl = [replace(item, frame=0) for item in wire(file_of(world, (-0.5,), home_alt=30.0))]
    assert world.upload(amsl).type == 12
