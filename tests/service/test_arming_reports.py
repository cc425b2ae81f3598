"""Why the real service cannot be armed, as its events say it: in each mode, and as what the vehicle knows changes."""

import json

import pytest
from event_reports import EventMetadata, Report
from piloted_world import ALTITUDE, MANUAL, PilotedWorld

from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import CommandResult
from autopilot.mavlink.event_metadata import events_json
from autopilot.mavlink.profiles import PROFILES
from autopilot.mission.paper import paper_plan

METADATA = EventMetadata(json.loads(json.dumps(events_json(PROFILES["px4"]))))
ALL = {"position", "mission", "positionless"}
ARM, RUN_PREARM_CHECKS = 400, 401


def report(world: PilotedWorld) -> Report:
    """The latest."""
    return METADATA.reports([message for message in world.inbox if message.get_type() == "EVENT"])[-1]


def texts(world: PilotedWorld) -> set[str]:
    return {text for text, _, _ in report(world).reasons}


def test_the_report_is_what_arming_says() -> None:
    world = PilotedWorld(fixes=False, depth=True)
    world.run(2.5)
    first = report(world)
    assert first.can_arm == {"positionless"} and first.wrong == {"position"}
    ((text, component, modes),) = first.reasons
    assert "no position yet" in text and component == "position" and modes == ALL - {"positionless"}
    assert world.command(ARM, 1.0) == CommandResult.DENIED and text in world.texts()
    for mode in (MANUAL, ALTITUDE):
        assert world.mode(mode) == CommandResult.ACCEPTED and METADATA.group_of(mode) == "positionless"
    world.fixes = True
    world.run(3.0)
    assert report(world).can_arm == ALL and not report(world).reasons
    world.arm()
    world.run(1.0)
    assert not [message for message in world.inbox if message.get_type() == "EVENT"], "nothing has changed"


@pytest.mark.parametrize(
    ("name", "value", "says", "component"),
    [
        ("DEPTH_MIN", 1.2, "the depth band is empty: set DEPTH_MIN below DEPTH_MAX", "fence"),
        ("FENCE_REQUIRED", 1.0, "no fence in force: upload one (FENCE_REQUIRED 0: only warn)", "fence"),
        ("FS_BATT_LOW", 0.95, "battery at 90 %: charge it", "battery"),
    ],
)
def test_a_reason_that_comes_and_goes_is_reported_each_time(name: str, value: float, says: str, component: str) -> None:
    world = PilotedWorld(params={"DEPTH_MAX": 1.2, name: value})
    if name == "FENCE_REQUIRED":
        assert world.parts.plans.replace(PlanKind.FENCE, ()) is None
    world.run(3.0)
    assert says in texts(world) and component in report(world).wrong and report(world).can_arm == set()
    world.params.set(name, 0.1 if name != "FENCE_REQUIRED" else 0.0)
    world.run(3.0)
    assert says not in texts(world) and component not in report(world).wrong


def test_an_armed_vehicle_reports_what_keeps_it_from_its_mission() -> None:
    world = PilotedWorld()
    assert world.parts.plans.replace(PlanKind.MISSION, paper_plan(1).mission) is None
    world.run(2.0)
    world.arm()
    world.run(1.0)
    assert world.command(RUN_PREARM_CHECKS) == CommandResult.TEMPORARILY_REJECTED
    world.run(1.0)
    assert report(world).can_run == ALL
    world.params.set("DEPTH_MAX", 0.35)
    world.run(4.0)
    reasons = report(world).reasons
    assert reasons[0][0].startswith("plan: item 0 (QGC 1): ") and {(part, *modes) for _, part, modes in reasons} == {
        ("mission",) * 2
    }
    assert report(world).can_run == ALL - {"mission"}
