"""A commander with everything that it looks at under the test's hand."""

from typing import Any

import numpy as np

from autopilot.command.commander import Commander
from autopilot.command.conditions import TickInputs
from autopilot.command.decision import Decision
from autopilot.command.facts import VehicleStatus
from autopilot.core.desk import Desk
from autopilot.core.messages import NavDoubt, NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanKind
from autopilot.core.samples import PowerSample
from autopilot.core.vehicle import load_vehicle
from autopilot.mavlink.api import CommandResult
from autopilot.mission.paper import paper_plan
from autopilot.mission.store import Plans

TICK_US = 10_000
OK = CommandResult.ACCEPTED


class Bench:
    """Runs the commander tick by tick."""

    def __init__(self, *, desk: Desk | None = None, **params: float) -> None:
        self.params = ParamSet(params)
        vehicle = load_vehicle("lbv150")
        self.plans = Plans(self.params, vehicle.radius_m, desk=desk)
        self.commander = Commander(vehicle, self.params, self.plans)
        self.t_us = 0
        self.pos = np.array([-1.0, 0.5, 0.5])
        self.yaw = 0.0
        self.health: NavHealth | None = NavHealth.GOOD
        self.remaining = 0.9
        self.ahrs_age_s: float | None = 0.01
        self.vel_frd_m_s = np.zeros(3)
        self.current = np.zeros(3)
        self.failures = 0
        self.unreachable = False
        self.thruster_share: tuple[float, ...] = (1.0,) * 4
        self.thruster_problem = ""
        self.thrusters_unseen: tuple[str, ...] = ()
        self.thrusters_doubtful: tuple[tuple[str, ...], ...] = ()
        self.command_delay_s = 0.0
        self.doubts: frozenset[NavDoubt] = frozenset()
        self.facts = VehicleStatus()
        self.texts: list[str] = []

    def nav(self) -> NavState | None:
        if self.health is None:
            return None
        zero = np.zeros(3)
        return NavState(
            t_us=self.t_us,
            health=self.health,
            pos_ned_m=self.pos,
            rpy_rad=np.array([0.0, 0.0, self.yaw]),
            vel_frd_m_s=self.vel_frd_m_s,
            vel_water_frd_m_s=zero,
            rate_frd_rad_s=zero,
            current_ned_m_s=self.current,
            variance=np.zeros(12),
        )

    def run(self, seconds: float = 0.01) -> Decision:
        for _ in range(max(1, round(seconds * 100))):
            self.t_us += TICK_US
            decision = self.commander.step(
                TickInputs(
                    t_us=self.t_us,
                    nav=self.nav(),
                    power=PowerSample(
                        t_us=self.t_us, voltage_v=18.0, current_a=1.0, energy_used_j=0.0, remaining=self.remaining
                    ),
                    ahrs_age_s=self.ahrs_age_s,
                    solver_failures=self.failures,
                    unreachable=self.unreachable,
                    thruster_share=self.thruster_share,
                    thruster_problem=self.thruster_problem,
                    thrusters_unseen=self.thrusters_unseen,
                    thrusters_doubtful=self.thrusters_doubtful,
                    command_delay_s=self.command_delay_s,
                    nav_doubts=self.doubts,
                    facts=self.facts,
                )
            )
            self.texts += [event.text for event in self.commander.drain_events()]
        return decision

    def load(self, laps: int = 1) -> None:
        plan = paper_plan(laps)
        assert self.plans.replace(PlanKind.FENCE, plan.fence) is None
        assert self.plans.replace(PlanKind.MISSION, plan.mission) is None

    def armed(self, **_: Any) -> "Bench":
        self.run()
        assert self.commander.arm(force=False).result is OK
        return self
