"""Plans that do not fit each other, against the whole service: stored, told, and flown by no route."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import Harbour, WireClient

from autopilot.core.plan import MissionResult, PlanItem, PlanKind
from autopilot.core.plan_wire import item_message
from autopilot.mission.paper import paper_plan

PLAN = paper_plan(1)
ACCEPTED, DENIED = mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED
ARM, START, PAUSE_CONTINUE = mav.MAV_CMD_COMPONENT_ARM_DISARM, mav.MAV_CMD_MISSION_START, mav.MAV_CMD_DO_PAUSE_CONTINUE
FORCE = 2989.0
INTO_THE_PILLAR = replace(PLAN.mission[1], frame=1, x=9375, y=0, z=0.5)
BAD_MISSION = (PLAN.mission[0], INTO_THE_PILLAR, *PLAN.mission[2:])
PX4_MISSION = (1.0, 4.0, 4.0)
"""DO_SET_MODE of the default profile: AUTO MISSION."""

Open = Callable[..., tuple[Harbour, WireClient]]


@pytest.fixture
def harbour(session: OpenSession) -> Open:
    """A vehicle without plans in the tank, and a client."""

    def make(**params: float) -> tuple[Harbour, WireClient]:
        client = WireClient()
        made = Harbour(session(sensors="pose", peers=(client,), params=params))
        made.run(1.5)
        return made, client

    return make


def _upload(made: Harbour, client: WireClient, *plans: tuple[PlanKind, tuple[PlanItem, ...]]) -> list[str]:
    """Offer plans one after the other as QGroundControl does; what was said."""
    texts: list[str] = []
    for kind, items in plans:
        assert made.offer(client, kind, items) == MissionResult.ACCEPTED, client.texts()
        texts += client.texts()
    return texts


def _state(client: WireClient) -> tuple[bool, int, bool, int]:
    """Armed, custom mode, whether the arming checks pass, landed state: as telemetry says."""
    beat = client.received("HEARTBEAT")[-1]
    checks = client.received("SYS_STATUS")[-1].onboard_control_sensors_health & mav.MAV_SYS_STATUS_PREARM_CHECK
    landed = client.received("EXTENDED_SYS_STATE")[-1].landed_state
    return bool(beat.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED), beat.custom_mode, bool(checks), landed


def _every_way_to_start(made: Harbour, client: WireClient) -> dict[str, Any]:
    """Result of each request that could begin the mission."""
    results: dict[str, Any] = {}
    results["start"] = made.command(client, START)
    results["start at an item"] = made.command(client, START, 1.0)
    results["mode"] = made.command(client, mav.MAV_CMD_DO_SET_MODE, *PX4_MISSION)
    results["continue"] = made.command(client, PAUSE_CONTINUE, 1.0)
    made.command(client, mav.MAV_CMD_DO_SET_MISSION_CURRENT, 1.0)
    results["item, then mode"] = made.command(client, mav.MAV_CMD_DO_SET_MODE, *PX4_MISSION)
    client.inbox.clear()
    client.send(mav.MAVLink_set_mode_message(1, 1, 4 << 24 | 4 << 16))
    made.run(0.2)
    results["old mode message"] = DENIED if made.session.parts.commander.mode.name != "MISSION" else ACCEPTED
    return results


def test_a_mission_into_an_obstacle_in_the_order_of_a_ground_station(harbour: Open) -> None:
    """Mission, fence, rally. At one time the fence was refused and the vehicle flew into the pillar, unfenced."""
    made, client = harbour()
    kinds = ((PlanKind.MISSION, BAD_MISSION), (PlanKind.FENCE, PLAN.fence), (PlanKind.RALLY, ()))
    (text,) = _upload(made, client, *kinds)
    assert (
        text.startswith("No start: item 1 (QGC 2) is 0.1") and "exclusion circle (fence item 5): move it" in text[:90]
    )
    made.run(1.1)
    assert _state(client)[:3] == (False, _state(client)[1], False)
    assert made.command(client, ARM, 1.0) == DENIED
    assert client.texts()[0].startswith("Arming denied: plan: item 1 (QGC 2) is")
    assert set(_every_way_to_start(made, client).values()) == {DENIED}
    # Forced arming is the operator's right; what he forces is a vehicle that holds, not the mission.
    assert made.command(client, ARM, 1.0, FORCE) == ACCEPTED
    assert set(_every_way_to_start(made, client).values()) == {DENIED}
    made.run(2.0)
    commander = made.session.parts.commander
    assert commander.armed and commander.mode.name == "HOLD"
    assert not _state(client)[2]
    # Mended in flight: the mission is replaced, and may be started.
    assert made.offer(client, PlanKind.MISSION, PLAN.mission) == MissionResult.ACCEPTED
    assert "Plan ok" in client.texts(least=mav.MAV_SEVERITY_INFO)
    assert made.command(client, START) == ACCEPTED
    made.run(0.5)
    assert commander.mode.name == "MISSION"


def test_a_paused_mission_does_not_go_on_when_its_fence_has_changed(harbour: Open) -> None:
    made, client = harbour(FENCE_ARMED_CHG=1.0)
    _upload(made, client, (PlanKind.FENCE, PLAN.fence), (PlanKind.MISSION, PLAN.mission))
    assert made.command(client, ARM, 1.0) == ACCEPTED
    assert made.command(client, START) == ACCEPTED
    made.run(1.0)
    assert made.command(client, PAUSE_CONTINUE, 0.0) == ACCEPTED
    over_item_1 = replace(PLAN.mission[1], seq=4, command=5004, param1=0.1, z=0.0)
    (text,) = _upload(made, client, (PlanKind.FENCE, (*PLAN.fence[:4], over_item_1)))
    assert "item 1 (QGC 2) is" in text
    assert set(_every_way_to_start(made, client).values()) == {DENIED}
    assert made.offer(client, PlanKind.FENCE, PLAN.fence) == MissionResult.ACCEPTED
    assert "Plan ok" in client.texts(least=mav.MAV_SEVERITY_INFO)
    assert made.command(client, PAUSE_CONTINUE, 1.0) == ACCEPTED


def test_a_long_check_is_waited_for_and_its_answer_is_given_once(
    harbour: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The client sends its last item again while the plan is checked: no second upload, no error, one answer."""
    made, client = harbour()
    monkeypatch.setattr("autopilot.mission.store.CHECK_TICKS", 300)
    client.send(mav.MAVLink_mission_count_message(1, 1, len(PLAN.fence), 1))
    for item in PLAN.fence:
        made.run(0.1)
        client.send(item_message(item, PlanKind.FENCE))
    for _ in range(5):
        made.run(0.5)
        assert not client.received("MISSION_ACK")
        client.send(item_message(PLAN.fence[-1], PlanKind.FENCE))
        client.send(mav.MAVLink_mission_request_list_message(1, 1, 1))
    assert [m.count for m in client.received("MISSION_COUNT")] == [0] * 4, "the plan in force is still the old one"
    made.run(1.0)
    assert [m.type for m in client.received("MISSION_ACK")] == [MissionResult.ACCEPTED]
    assert len(client.received("MISSION_REQUEST_INT")) == len(PLAN.fence)
    client.send(item_message(PLAN.fence[-1], PlanKind.FENCE))
    made.run(0.1)
    assert [m.type for m in client.received("MISSION_ACK")] == [MissionResult.ACCEPTED] * 2, (
        "said again when asked again"
    )
