"""A commander with everything that it looks at under the test's hand."""

from dataclasses import replace
from typing import Any

import numpy as np

from autopilot.command.commander import Commander
from autopilot.command.decision import Decision
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core.background import BackgroundWorker
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanKind
from autopilot.core.samples import PowerSample
from autopilot.core.vehicle import load_vehicle
from autopilot.mavlink.api import CommandResult
from autopilot.mission.paper import paper_plan
from autopilot.mission.store import Plans
from tests import plan_items

TICK_US = 10_000
OK = CommandResult.ACCEPTED


class Bench:
    """Runs the commander tick by tick."""

    def __init__(self, *, worker: BackgroundWorker | None = None, **params: float) -> None:
        self.params = ParamSet(params)
        vehicle = load_vehicle("lbv150")
        self.plans = Plans(self.params, vehicle.radius_m, worker=worker)
        self.commander = Commander(vehicle, self.params, self.plans)
        self.t_us = 0
        self.pos = np.array([-1.0, 0.5, 0.5])
        self.yaw = 0.0
        self.health: NavHealth | None = NavHealth.GOOD
        self.remaining = 0.9
        self.vel_frd_m_s = np.zeros(3)
        self.current = np.zeros(3)
        self.status = VehicleStatus(ahrs_age_s=0.01, thruster_effectiveness=(1.0,) * 4)
        self.texts: list[str] = []

    def nav(self) -> NavState | None:
        if self.health is None:
            return None
        at = plan_items.nav(*self.pos.tolist(), self.yaw, self.t_us, self.health)
        return replace(at, vel_frd_m_s=self.vel_frd_m_s, current_ned_m_s=self.current)

    def run(self, seconds: float = 0.01) -> Decision:
        for _ in range(max(1, round(seconds * 100))):
            self.t_us += TICK_US
            status = self.status
            status.t_us, status.nav = self.t_us, self.nav()
            status.power = PowerSample(
                t_us=self.t_us, voltage_v=18.0, current_a=1.0, energy_used_j=0.0, remaining=self.remaining
            )
            self.plans.tick()
            decision = self.commander.step(status)
            self.texts += [event.text for event in self.commander.drain_events()]
        return decision

    def load(self, laps: int = 1) -> "Bench":
        plan = paper_plan(laps)
        assert self.plans.replace(PlanKind.FENCE, plan.fence) is None
        assert self.plans.replace(PlanKind.MISSION, plan.mission) is None
        return self

    def armed(self, **_: Any) -> "Bench":
        self.run()
        assert self.commander.arm(force=False).result is OK
        return self
