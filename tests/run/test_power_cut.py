"""The flight controller below loses power in every state of the vehicle: what the service has acknowledged stays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from test_vehicle_flight import Tank, _flies

from autopilot.core.messages import Outputs
from autopilot.core.plan import PlanKind
from autopilot.core.vehicle import load_vehicle
from autopilot.run.kept_plans import KeptPlans
from autopilot.sitl.ardusub_emulator import ArduSubEmulator

CUT_S = 2.0


@pytest.fixture
def tank(tmp_path: Path) -> Iterator[Tank]:
    made = Tank(tmp_path)
    yield made
    made.close()


@pytest.mark.parametrize("state", ["disarmed", "armed", "mission"])
def test_a_flight_controller_that_lost_power_is_not_armed_again_and_nothing_is_forgotten(
    tank: Tank, state: str
) -> None:
    parts = tank.session.parts
    commander, plans, params = parts.commander, parts.plans, parts.params
    if state == "mission":
        tank.run(_flies, 60.0)
    else:
        tank.run(lambda _: tank.below.armed, 60.0)
        if state == "disarmed":
            commander.disarm(force=False)
            tank.run(lambda _: not tank.below.armed, 3.0)
    had = {kind: plans.items(kind) for kind in PlanKind}, dict(params)
    assert had[0][PlanKind.FENCE] and had[0][PlanKind.MISSION]

    def later(seconds: float) -> None:
        end_us = tank._t_us + round(1e6 * seconds)

        def over(outputs: Outputs) -> bool:
            return outputs.t_us >= end_us

        tank.run(over, seconds + 1.0)

    tank.unheard = True
    later(CUT_S)
    tank.world.controller = tank.below = ArduSubEmulator(load_vehicle("bluerov2"), "vectored", seed=2)
    tank.unheard = False
    assert not tank.below.armed
    later(5.0)
    assert not tank.below.armed, "nobody has asked for it"
    assert not commander.armed and tank.outputs is not None and not tank.outputs.mode.armed
    assert ({kind: plans.items(kind) for kind in PlanKind}, dict(params)) == had
    assert tank.session.kept.plans is not None
    tank.session.kept.plans.finish()
    found = KeptPlans(tank.session.kept.folder / "plans.json", plans, commander)
    assert found.load() == (), "what is on disk is whole"
    assert {kind: plans.items(kind) for kind in PlanKind} == had[0]
