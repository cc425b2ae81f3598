"""The real service in flight: what is planned beside its loop, what is not planned at all, and planners that fail."""

import threading
from typing import Any

import numpy as np
import pytest

from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.path.planner import Planner
from autopilot.control.robust import regions
from autopilot.core.messages import Outputs, Severity
from tests.bench.faults.pilot import go_to, on_its_way, piloted

WARNING = "No energy plan: flying the plain route"


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
    with piloted("paper-tank", {"MPC_COST": cost}) as flight:
        on_its_way(flight, 2.0 if cost else 4.0)
    assert threads["trajectory" if cost else "route"] and threads["certificate"]
    assert threading.get_ident() not in {ident for idents in threads.values() for ident in idents}


def test_of_many_go_tos_only_the_last_is_planned_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    sound, done = EnergyPlanner.plan, []

    def plan(self: EnergyPlanner, request: Any, *args: Any) -> Any:
        made = sound(self, request, *args)
        done.append(request.goal.pos_ned_m)
        return made

    monkeypatch.setattr(EnergyPlanner, "plan", plan)
    with piloted("paper-tank", {"MPC_COST": 1.0}) as flight:
        on_its_way(flight, 1.0)
        done.clear()
        for i in range(12):
            go_to(flight, (1.2 + 0.02 * i, 0.9, 0.4))
            flight.fly(0.1)
        flight.fly(2.5)
        assert flight.outputs is not None and flight.outputs.goal is not None
        assert np.allclose(flight.outputs.goal.pos_ned_m, (1.42, 0.9, 0.4), atol=0.01)
        assert done and all(np.allclose(one, flight.outputs.goal.pos_ned_m) for one in done)


def test_a_planner_that_fails_costs_the_trajectory_and_not_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    def plan(*_: Any, **__: Any) -> Any:
        raise MemoryError("IPOPT")

    monkeypatch.setattr(EnergyPlanner, "plan", plan)
    seen: list[Outputs] = []
    with piloted("paper-tank", {"MPC_COST": 1.0}) as flight:
        flight.on_tick = seen.append
        on_its_way(flight, 1.0)
        begin = flight.session.device.truth.pos_ned_m.copy()
        flight.fly(6.0)
        assert np.linalg.norm(flight.session.device.truth.pos_ned_m - begin) > 0.5, "it flies by the plain route"
        assert flight.session.parts.commander.armed
        assert flight.pilot.texts().count(WARNING) == 1
    logged = [event for outputs in seen for event in outputs.events]
    assert sum(event.severity == Severity.DEBUG and "MemoryError: IPOPT" in event.text for event in logged) == 1


def test_withdrawn_requests_leave_no_trace_in_a_run() -> None:
    """Which of the overtaken plans and routes were begun depends on the machine; what is flown does not."""

    def flown() -> bytes:
        trace: list[bytes] = []
        with piloted("paper-tank", {"MPC_COST": 1.0}) as flight:
            on_its_way(flight, 0.5)
            flight.on_tick = lambda outputs: trace.append(repr(outputs.command.pwm_us).encode())
            for i in range(4):
                go_to(flight, (1.2 + 0.05 * i, 0.9, 0.4))
                flight.fly(0.08)
            flight.fly(0.3)
            flight.session.parts.params.set("MPC_COST", 0.0)
            for i in range(4):
                go_to(flight, (1.75 - 0.05 * i, -0.9, 0.4))
                flight.fly(0.06)
            flight.fly(0.5)
        return b"".join(trace)

    assert flown() == flown()
