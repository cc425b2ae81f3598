"""The real service in flight: what is planned beside its loop, what is not planned at all, and planners that fail."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as mav

from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.path.planner import Planner
from autopilot.control.robust import regions
from autopilot.core.geodesy import geodetic_from_ned
from autopilot.core.messages import Outputs, Severity
from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl
from tests.system.wire_client import Harbour, WireClient

WARNING = "No energy plan: flying the plain route"
ARM, START, REPOSITION = 400, 300, 192


class Flight(Harbour):
    """The paper's tank with the paper's plan, and a ground station."""

    def __init__(self, folder: Path, cost: float) -> None:
        self.client, self.outputs = WireClient(), list[Outputs]()
        settings = flight_settings(folder, {"scenario": "paper-tank", "sensors": "pose"})
        super().__init__(open_sitl(settings, {"MPC_COST": cost}, log=False, peers=(self.client,)))

    def tick(self) -> Outputs:
        self.outputs.append(super().tick())
        return self.outputs[-1]

    def start(self) -> None:
        self.run(2.5)
        plan = paper_plan(1)
        for kind, items in ((PlanKind.FENCE, plan.fence), (PlanKind.MISSION, plan.mission)):
            assert self.offer(self.client, kind, items) == mav.MAV_MISSION_ACCEPTED
        for command, param in ((ARM, 1.0), (START, 0.0)):
            assert self.command(self.client, command, param) == mav.MAV_RESULT_ACCEPTED, self.client.texts()

    def go_to(self, north_m: float, east_m: float, down_m: float) -> None:
        here = np.array((north_m, east_m, down_m))
        lat_deg, lon_deg, _ = geodetic_from_ned(self.session.parts.plans.origin, here)
        place = (round(lat_deg * 1e7), round(lon_deg * 1e7), -down_m)
        self.client.send(mav.MAVLink_command_int_message(1, 1, 6, REPOSITION, 0, 0, -1.0, 1.0, 0.0, np.nan, *place))


@contextmanager
def flying(cost: float, seconds: float) -> Iterator[Flight]:
    """Under way for so long."""
    with TemporaryDirectory() as folder:
        flight = Flight(Path(folder), cost)
        flight.start()
        flight.run(seconds)
        yield flight
        flight.session.close()


@pytest.mark.parametrize("cost", [0.0, 1.0])
def test_nothing_slow_runs_on_the_thread_of_the_loop(monkeypatch: pytest.MonkeyPatch, cost: float) -> None:
    threads: dict[str, list[int]] = {"route": [], "trajectory": [], "certificate": []}

    def note(owner: Any, name: str, kind: str) -> None:
        sound = getattr(owner, name)

        def noted(*args: Any, **kwargs: Any) -> Any:
            threads[kind].append(threading.get_ident())
            return sound(*args, **kwargs)

        monkeypatch.setattr(owner, name, noted)

    note(Planner, "path", "route")
    note(EnergyPlanner, "plan", "trajectory")
    note(regions, "certify", "certificate")
    with flying(cost, 2.0 if cost else 4.0):
        pass
    assert threads["trajectory" if cost else "route"] and threads["certificate"]
    assert threading.get_ident() not in {ident for idents in threads.values() for ident in idents}


def test_of_many_go_tos_only_the_last_is_planned_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    sound, done = EnergyPlanner.plan, []

    def plan(self: EnergyPlanner, request: Any, *args: Any) -> Any:
        made = sound(self, request, *args)
        done.append(request.goal.pos_ned_m)
        return made

    monkeypatch.setattr(EnergyPlanner, "plan", plan)
    with flying(1.0, 1.0) as flight:
        done.clear()
        for i in range(12):
            flight.go_to(1.2 + 0.02 * i, 0.9, 0.4)
            flight.run(0.1)
        flight.run(2.5)
        goal = flight.outputs[-1].goal
        assert goal is not None and np.allclose(goal.pos_ned_m, (1.42, 0.9, 0.4), atol=0.01)
        assert done and all(np.allclose(one, goal.pos_ned_m) for one in done)


def test_a_planner_that_fails_costs_the_trajectory_and_not_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    def plan(*_: Any, **__: Any) -> Any:
        raise MemoryError("IPOPT")

    monkeypatch.setattr(EnergyPlanner, "plan", plan)
    with flying(1.0, 1.0) as flight:
        begin = flight.session.device.truth.pos_ned_m.copy()
        flight.run(6.0)
        assert np.linalg.norm(flight.session.device.truth.pos_ned_m - begin) > 0.5, "it flies by the plain route"
        assert flight.session.parts.commander.armed
        assert flight.client.texts().count(WARNING) == 1
    logged = [event for outputs in flight.outputs for event in outputs.events]
    assert sum(event.severity == Severity.DEBUG and "MemoryError: IPOPT" in event.text for event in logged) == 1


def test_withdrawn_requests_leave_no_trace_in_a_run() -> None:
    """Which of the overtaken plans and routes were begun depends on the machine; what is flown does not."""

    def flown() -> list[tuple[int, ...]]:
        with flying(1.0, 0.5) as flight:
            flight.outputs.clear()
            for i in range(4):
                flight.go_to(1.2 + 0.05 * i, 0.9, 0.4)
                flight.run(0.08)
            flight.run(0.3)
            flight.session.parts.params.set("MPC_COST", 0.0)
            for i in range(4):
                flight.go_to(1.75 - 0.05 * i, -0.9, 0.4)
                flight.run(0.06)
            flight.run(0.5)
        return [outputs.command.pwm_us for outputs in flight.outputs]

    assert flown() == flown()
