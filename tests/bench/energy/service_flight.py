"""A benchmark case flown by the whole service in the simulator: current estimated, vehicle not as believed."""

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.analysis.nmpc_flight import TANK
from autopilot.control.constraints.obstacles import clearance_m
from autopilot.control.energy.power import PowerModel
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Outputs
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.scenario import load_scenario, load_tables, plan_path
from autopilot.sitl.toml_text import toml_text
from tests.bench.energy.cases import REGION_M, REGION_YAW_RAD, Case
from tests.bench.energy.flight import EnergyFlight
from tests.bench.energy.record import MASS

LEG_LIMIT_S = 300.0


class _Score:
    """Energy and legs from the plant's truth, from the first thrust on."""

    def __init__(self, case: Case) -> None:
        self.session: SitlSession | None = None
        self._case, self._laps = case, case.laps
        self._goals = [goal for _ in range(case.laps) for goal in case.goals]
        self._last_s: float | None = None
        self.leg_j: list[float] = []
        self.leg_s: list[float] = []
        self.spent_j, self.top_m_s, self._begin_s, self._before_j = 0.0, 0.0, 0.0, 0.0
        self.track: list[FloatArray] = []

    @property
    def finished(self) -> bool:
        return len(self.leg_j) == len(self._goals)

    def tick(self, outputs: Outputs) -> None:
        if self.session is None or self.finished:
            return
        truth, vehicle = self.session.device.truth, self.session.vehicle
        now_s, thrust = truth.t_us * 1e-6, truth.thrust_n[: len(vehicle.thrusters)]
        if self._last_s is None:
            if float(np.abs(thrust).max()) == 0.0:
                return
            self._last_s = self._begin_s = now_s
        power = PowerModel.of(vehicle)
        self.spent_j += (now_s - self._last_s) * (power.hotel_w + float(np.asarray(power.thrust_w(thrust)).sum()))
        self._last_s = now_s
        self.top_m_s = max(self.top_m_s, math.hypot(*truth.vel_water_frd_m_s[:2]))
        self.track.append(truth.pos_ned_m[:2].copy())
        goal = self._goals[len(self.leg_j)]
        turned = 0.0 if goal.yaw_rad is None else abs(wrap_pi(float(truth.rpy_rad[2]) - goal.yaw_rad))
        if math.dist(truth.pos_ned_m, goal.pos_ned_m) <= REGION_M and turned <= REGION_YAW_RAD:
            self.leg_j.append(self.spent_j - self._before_j)
            self.leg_s.append(now_s - self._begin_s)
            self._before_j, self._begin_s = self.spent_j, now_s


def fly_service(case: Case, scenario: str, drag: float, currents: str = "estimate") -> EnergyFlight:
    """The scenario ``scenario`` with 20 % more mass and ``drag`` times the drag.

    ``currents``: what it knows of the flow, "estimate" or "map" (a map of the true flow, corrected by the estimate).
    """
    tables = load_tables(scenario)
    tables["vehicle"]["mismatch"] = {"mass": MASS, "drag": drag}
    tables["controller"]["currents"] = currents
    plan = plan_path(scenario, load_scenario(scenario))
    assert plan is not None
    flight = fly_tables(case, tables, plan, f"service, {currents}, drag {drag:g}")
    return replace(flight, drag=drag)


def fly_tables(
    case: Case, tables: dict[str, Any], plan: Path, pilot: str, controller: str | None = None
) -> EnergyFlight:
    """Fly the plan in the scenario of ``tables`` with the pose sensor; ``case`` has its goals.

    ``controller``: as ``--controller``, None = the scenario's.
    """
    score = _Score(case)
    with tempfile.TemporaryDirectory() as folder:
        tables["scenario"]["plan"] = str(plan)
        altered = Path(folder) / "altered.toml"
        altered.write_text(toml_text(tables))
        limit_s = LEG_LIMIT_S * len(case.goals) * case.laps
        given = {"speed": 0.0, "sensors": "pose", "duration": limit_s, "start": True, "scenario": str(altered)}
        settings = flight_settings(folder, {**given, **({"controller": controller} if controller else {})})
        session = open_sitl(settings, {}, log=False, on_tick=score.tick)
        score.session = session
        session.run(stop=lambda: score.finished)
    path = np.array(score.track)
    return EnergyFlight(
        case=case.name,
        pilot=pilot,
        finished=score.finished,
        energy_j=score.spent_j,
        leg_j=tuple(score.leg_j),
        leg_s=tuple(score.leg_s),
        nearest_m=float(clearance_m(TANK, path).min()) - session.vehicle.radius_m if case.tank else math.inf,
        top_m_s=score.top_m_s,
        track=path,
        laps=case.laps,
    )
