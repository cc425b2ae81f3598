"""That no fence is in force is said, shown, and where a tank is declared forbids arming."""

from collections.abc import Callable

import pytest
from plan_items import local
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import Harbour, WireClient

from autopilot.core.plan import MissionResult, PlanKind
from autopilot.mission.paper import paper_plan

PLAN = paper_plan(1)
ARM = mav.MAV_CMD_COMPONENT_ARM_DISARM
ACCEPTED, DENIED = mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED
FENCE_BIT, PREARM_BIT = mav.MAV_SYS_STATUS_GEOFENCE, mav.MAV_SYS_STATUS_PREARM_CHECK
WAIT_S = 2.5
"""A fence is awaited for 2 s."""

Open = Callable[..., tuple[Harbour, WireClient]]


@pytest.fixture(name="harbour")
def harbour_fixture(session: OpenSession) -> Open:
    """A vehicle without plans, and a client."""

    def make(scenario: str, **params: float) -> tuple[Harbour, WireClient]:
        client = WireClient()
        made = Harbour(session(scenario, sensors="pose", peers=(client,), params=params))
        made.session.parts.server._ctx.patience = 1.0  # as in real time
        made.run(1.5)
        return made, client

    return make


def shown(made: Harbour, client: WireClient) -> tuple[bool, bool, bool]:
    """SYS_STATUS: fence enabled, fence healthy, ready to arm."""
    client.inbox.clear()
    made.run(1.2)
    status = client.received("SYS_STATUS")[-1]
    assert status.onboard_control_sensors_present & FENCE_BIT
    health = status.onboard_control_sensors_health
    enabled = status.onboard_control_sensors_enabled & FENCE_BIT
    return bool(enabled), bool(health & FENCE_BIT), bool(health & PREARM_BIT)


def said(client: WireClient) -> list[str]:
    """What was said of a fence."""
    return [text for text in client.texts(least=mav.MAV_SEVERITY_NOTICE) if "fence in force" in text]


def test_a_tank_needs_a_fence_before_arming(harbour: Open) -> None:
    """A ground station that thinks that the vehicle knows no fences uploads the mission alone."""
    made, client = harbour("paper-tank")
    assert shown(made, client) == (True, False, False)
    assert made.offer(client, PlanKind.MISSION, PLAN.mission) == MissionResult.ACCEPTED
    assert not said(client)
    made.run(WAIT_S)
    assert said(client) == ["Mission with no fence in force: upload its fence, or keep clear of walls"]
    assert made.command(client, ARM, 1.0) == DENIED
    assert said(client) == ["Arming denied: no fence in force: upload one (FENCE_REQUIRED 0: only warn)"]
    assert made.command(client, mav.MAV_CMD_RUN_PREARM_CHECKS) == ACCEPTED
    assert "Arming check: no fence in force" in said(client)[0]
    assert made.offer(client, PlanKind.FENCE, PLAN.fence) == MissionResult.ACCEPTED
    assert shown(made, client) == (True, True, True)
    assert made.command(client, ARM, 1.0) == ACCEPTED
    assert not said(client)


def test_a_mission_of_kilometres_without_a_fence_is_taken_and_named_with_its_size(harbour: Open) -> None:
    made, client = harbour("open-water")
    rows = tuple(local(seq, 16, 100.0 * seq, 1200.0 * (seq % 2), 0.5, (0, 0, 0, 0)) for seq in range(12))
    assert made.offer(client, PlanKind.MISSION, rows) == MissionResult.ACCEPTED
    made.run(WAIT_S)
    assert said(client) == [
        "Mission of 13.2 km, 1.6 km from home, with no fence in force: upload its fence, or keep clear of walls"
    ]
    assert made.command(client, ARM, 1.0) == ACCEPTED


def test_the_order_of_a_ground_station_is_no_alarm_and_a_fence_that_goes_is(harbour: Open) -> None:
    made, client = harbour("paper-tank")
    plans = {PlanKind.MISSION: PLAN.mission, PlanKind.FENCE: PLAN.fence, PlanKind.RALLY: ()}
    texts: list[str] = []
    for kind, items in plans.items():
        made.run(1.0)
        assert made.offer(client, kind, items) == MissionResult.ACCEPTED
        texts += said(client)
    made.run(WAIT_S)
    assert not texts and not said(client)
    client.send(mav.MAVLink_mission_clear_all_message(1, 1, int(PlanKind.FENCE)))
    made.run(WAIT_S)
    assert [text.split(":")[0] for text in said(client)] == ["Mission with no fence in force"]


@pytest.mark.parametrize(("scenario", "params"), [("open-water", {}), ("paper-tank", {"FENCE_REQUIRED": 0.0})])
def test_elsewhere_it_is_a_warning(harbour: Open, scenario: str, params: dict[str, float]) -> None:
    made, client = harbour(scenario, **params)
    assert shown(made, client) == (False, False, True)
    assert made.command(client, mav.MAV_CMD_RUN_PREARM_CHECKS) == ACCEPTED
    assert said(client) == ["Arming check: no fence in force, which FENCE_REQUIRED allows"]
    assert made.command(client, ARM, 1.0) == ACCEPTED
    made.run(0.1)
    assert said(client) == ["Armed with no fence in force: keep clear of walls, or upload one"]


def test_a_vehicle_in_a_closed_basin_needs_a_fence() -> None:
    from autopilot.core.params import ParamSet
    from autopilot.run.vehicle_config import apply_parameters, load_config

    params = ParamSet()
    config = load_config("lbv150.toml")
    apply_parameters(config, params)
    assert params["FENCE_REQUIRED"] == (config.file.place.basin == "closed")
