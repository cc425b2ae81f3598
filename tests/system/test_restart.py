"""A service is killed in the middle of a mission: the next one has its plans, its parameters and its place in them."""

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav

from autopilot.client.client_session import VehicleConnection
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.run.children import Child, autopilot_command, free_port


class Vehicle:
    """A service in its own process and a client that talks to it."""

    def __init__(self, child: Child, session: VehicleConnection) -> None:
        self.child, self.session = child, session

    def wait(self, what: Callable[[Any], bool]) -> Any:
        """The first message of that kind. Goes on as long as the service computes."""
        while True:
            for message in self.session.poll():
                if what(message):
                    return message
            assert self.child.at_work()
            cpu_s = self.child.cpu_s()
            assert cpu_s is None or cpu_s < 90.0, "it never came"

    def wait_for(self, name: str, **fields: Any) -> Any:
        return self.wait(
            lambda m: m.get_type() == name and all(getattr(m, key) == value for key, value in fields.items())
        )

    def set_param(self, name: str, value: float) -> None:
        self.session.send(mav.MAVLink_param_set_message(1, 1, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32))
        self.wait_for("PARAM_VALUE", param_id=name)

    def param(self, name: str) -> float:
        self.session.send(mav.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
        return float(self.wait_for("PARAM_VALUE", param_id=name).param_value)


@contextlib.contextmanager
def vehicle(folder: Path, *arguments: str) -> Iterator[Vehicle]:
    port = free_port()
    command = autopilot_command(
        *("sitl", "paper-tank", "--quiet", "--sensors", "pose", "--speed", "0", "--keep-plans"),
        *("--param", "MPC_COST=0"),
        *("--connect", f"udpin:127.0.0.1:{port}", *arguments),
    )
    places = {"AUTOPILOT_STATE_DIR": str(folder / "state"), "AUTOPILOT_LOG_DIR": str(folder / "logs")}
    child = Child(command, places)
    try:
        with VehicleConnection(f"udpout:127.0.0.1:{port}", at_work=child.at_work) as session:
            session.connect(60.0)
            yield Vehicle(child, session)
    finally:
        child.process.kill()
        child.process.wait()


def rally() -> tuple[PlanItem, ...]:
    first = paper_plan().mission[0]
    return (PlanItem(seq=0, frame=first.frame, command=mav.MAV_CMD_NAV_RALLY_POINT, x=first.x, y=first.y, z=first.z),)


@pytest.mark.long
def test_a_killed_service_comes_up_with_what_it_had(tmp_path: Path) -> None:
    plan = paper_plan(laps=500)
    plans = {PlanKind.FENCE: plan.fence, PlanKind.MISSION: plan.mission, PlanKind.RALLY: rally()}
    with vehicle(tmp_path) as before:
        for kind, items in plans.items():
            before.session.upload(kind, items)
        before.set_param("SPD_CRUISE", 0.30)
        before.wait(lambda m: m.get_type() == "SYS_STATUS" and m.onboard_control_sensors_health & (1 << 28))
        before.session.arm()
        before.session.start_mission()
        before.wait_for("MISSION_ITEM_REACHED", seq=1)
        before.wait_for("MISSION_CURRENT", seq=2)
        before.wait_for("HEARTBEAT")
        had = {kind: before.session.download(kind) for kind in PlanKind}
        before.child.process.kill()
        before.child.process.wait()
    stood = json.loads((tmp_path / "state" / "sitl-0" / "plans.json").read_text().splitlines()[1])["position"]
    assert stood["reached_seq"] >= 1 and stood["cursor"] >= 1
    with vehicle(tmp_path) as after:
        after.wait_for("MISSION_CURRENT", seq=stood["cursor"])
        assert not after.wait_for("HEARTBEAT").base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED
        for kind in PlanKind:
            assert repr(after.session.download(kind)) == repr(had[kind])
        assert after.param("SPD_CRUISE") == 0.30000001192092896
        after.wait(lambda m: m.get_type() == "SYS_STATUS" and m.onboard_control_sensors_health & (1 << 28))
        after.session.arm()
        after.session.start_mission()
        assert after.wait_for("MISSION_ITEM_REACHED").seq >= 1
    left = {path.name for path in (tmp_path / "state").rglob("*") if path.is_file()}
    kept = {"plans.json", "plans.json.previous", "parameters.params", "parameters.params.previous"}
    assert left - kept <= {"plans.json.new"}, "a write that the second kill broke off, and nothing of the first"
