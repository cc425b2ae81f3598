"""Failsafe inputs derived from the vehicle's status over time, most at 10 Hz.

NaN = unknown or not applicable.
"""

import math
from collections import deque
from collections.abc import Sequence

from autopilot.command.command_tuning import FAILSAFE_INPUTS
from autopilot.command.vehicle_status import NEVER, VehicleStatus
from autopilot.core.messages import NavHealth
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.mission.goals import Goals
from autopilot.mission.items import Step, flown_order
from autopilot.mission.sequencer import Position, Sequencer
from autopilot.mission.store import Plans


class FailsafeInputs:
    """Numbers of now, refreshed by :meth:`update`."""

    def __init__(self, vehicle: Vehicle, params: ParamSet, plans: Plans, goals: Goals, sequencer: Sequencer) -> None:
        self._radius_m = vehicle.radius_m
        self._capacity_j = vehicle.battery.capacity_j
        self._limits = vehicle.battery.limits
        self._params = params
        self._plans = plans
        self._goals = goals
        self._sequencer = sequencer
        self._updated_us = self._energy_us = 0
        self._known = False
        self._fix_us = 0
        self._blind_us: int | None = None
        self._slow_us: int | None = None
        self._slow_left_m = math.inf
        """Path left then."""
        self._last_m: tuple[float, float, float] | None = None
        self._travelled_m = 0.0
        self._spent: deque[tuple[int, float, float]] = deque(maxlen=int(FAILSAFE_INPUTS.window_s))
        self._rest: tuple[Position | None, int, float] | None = None
        self._low_us: int | None = None
        self._critical_us: int | None = None
        self.has_markers = True
        """Whether the position comes from markers, not from another source of poses."""
        self.armed_us: float = math.inf
        """When it was armed; inf = it is not."""
        self.nav_lost = 0.0
        """1 = the estimate is not valid though it has been, or though the vehicle is armed."""
        self.no_fix_s = NEVER
        self.beyond_m = NEVER
        """How far the vehicle's ball reaches beyond fence or depth band, negative = inside."""
        self.tilt_deg = NEVER
        self.stuck_s = NEVER
        self.tether_m = NEVER
        self.blind_s = NEVER
        """Time of the ascent without a position."""
        self.energy_lack = NEVER
        """Share of the battery that is missing for the rest of the mission and the reserve."""
        self.silent_s = NEVER
        self.silent_sensor = ""
        self.silent_how = ""
        """Silent, or worse."""
        self.low_voltage = self.critical_voltage = math.inf
        """-1 = the voltage is too low and has been for BATT_LOW_TIMER, else inf."""

    def update(
        self, status: VehicleStatus, *, armed: bool, surfacing: bool, on_mission: bool, blind: bool = False
    ) -> None:
        """Once per tick. ``blind``: a mode that needs no position is being piloted."""
        t_us, nav = status.t_us, status.nav
        valid = nav is not None and nav.health is not NavHealth.INVALID
        self._known = self._known or valid
        self.nav_lost = 1.0 if (self._known or armed) and not valid and not blind else 0.0
        if not armed:
            self.armed_us = math.inf
        elif self.armed_us == math.inf:
            self._begin(t_us)
        if nav is not None and nav.health is NavHealth.GOOD:
            self._fix_us = t_us
        if t_us - self._updated_us < FAILSAFE_INPUTS.update_us:
            return
        self._updated_us = t_us
        self.no_fix_s = 1e-6 * (t_us - self._fix_us) if self._known else NEVER
        self._update_ascent(t_us, blind=armed and surfacing and not valid)
        self.silent_s, self.silent_sensor = status.silent(t_us)
        self.silent_how = status.how_silent(self.silent_sensor)
        self._update_voltage(status)
        if nav is None or not valid:
            self.beyond_m = self.stuck_s = self.tether_m = NEVER
        elif armed:
            self._update_place(status, on_mission=on_mission)
        if nav is not None:
            roll, pitch, _ = nav.rpy_rad.tolist()
            self.tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch)))))

    def _begin(self, t_us: int) -> None:
        self.armed_us = t_us
        self._travelled_m, self._last_m, self._slow_us = 0.0, None, None
        self._spent.clear()
        self.beyond_m = self.stuck_s = self.tether_m = self.energy_lack = NEVER

    def _update_ascent(self, t_us: int, *, blind: bool) -> None:
        if not blind:
            self._blind_us, self.blind_s = None, NEVER
            return
        self._blind_us = t_us if self._blind_us is None else self._blind_us
        self.blind_s = 1e-6 * (t_us - self._blind_us)

    def _update_voltage(self, status: VehicleStatus) -> None:
        power, params = status.power, self._params
        if power is None:
            return
        t_us, patience_us = status.t_us, params["BATT_LOW_TIMER"] * 1e6
        if power.voltage_v >= (params["BATT_LOW_VOLT"] or self._limits.low_v):
            self._low_us = None
        elif self._low_us is None:
            self._low_us = t_us
        if power.voltage_v >= (params["BATT_CRT_VOLT"] or self._limits.critical_v):
            self._critical_us = None
        elif self._critical_us is None:
            self._critical_us = t_us
        self.low_voltage = -1.0 if self._low_us is not None and t_us - self._low_us >= patience_us else math.inf
        late = self._critical_us is not None and t_us - self._critical_us >= patience_us
        self.critical_voltage = -1.0 if late else math.inf

    def _update_place(self, status: VehicleStatus, *, on_mission: bool) -> None:
        nav, params = status.nav, self._params
        assert nav is not None
        x, y, z = place = tuple(nav.pos_ned_m.tolist())
        deep_m = max(z - params["DEPTH_MAX"], params["DEPTH_MIN"] - z - self._goals.top_m)
        self.beyond_m = max(self._radius_m - self._goals.clearance_m(nav.pos_ned_m), deep_m)
        if self._last_m is not None:
            self._travelled_m += math.dist(place, self._last_m)
        self._last_m = (x, y, z)
        home = self._plans.home_ned_m.tolist()
        self.tether_m = self._travelled_m if params["TETHER_COUNT"] else math.dist(place, home)
        self._update_motion(status)
        if status.t_us - self._energy_us >= FAILSAFE_INPUTS.energy_us:
            self._energy_us = status.t_us
            self._update_energy(status, on_mission=on_mission)

    def _update_motion(self, status: VehicleStatus) -> None:
        nav, thrust_n, left_m = status.nav, status.thrust_n, status.path_left_m
        assert nav is not None
        vx, vy, vz = nav.vel_frd_m_s.tolist()
        slow = vx * vx + vy * vy + vz * vz < FAILSAFE_INPUTS.slow_m_s * FAILSAFE_INPUTS.slow_m_s
        pushes = (
            thrust_n is not None and float(abs(thrust_n).max()) >= FAILSAFE_INPUTS.pushed * self._params["THR_LIMIT"]
        )
        if not (slow and pushes and left_m is not None and left_m > FAILSAFE_INPUTS.away_m):
            self._slow_us, self.stuck_s = None, 0.0
            return
        if self._slow_us is None or left_m < self._slow_left_m - FAILSAFE_INPUTS.nearer_m:
            self._slow_us, self._slow_left_m = status.t_us, left_m
        self.stuck_s = 1e-6 * (status.t_us - self._slow_us)

    def _update_energy(self, status: VehicleStatus, *, on_mission: bool) -> None:
        power = status.power
        if power is None or not on_mission:
            self._spent.clear()
            self.energy_lack = NEVER
            return
        self._spent.append((status.t_us, power.energy_used_j, self._travelled_m))
        then_us, then_j, then_m = self._spent[0]
        distance_m = self._travelled_m - then_m
        if status.t_us - then_us < FAILSAFE_INPUTS.least_s * 1e6 or distance_m < FAILSAFE_INPUTS.least_m:
            return
        j_m = (power.energy_used_j - then_j) / distance_m
        left_m = (status.path_left_m or 0.0) + self._rest_m()
        self.energy_lack = left_m * j_m / self._capacity_j + self._params["FS_ENRG_RES"] - power.remaining

    def _rest_m(self) -> float:
        """Path length of the mission beyond the present goal, straight between waypoints, with jumps."""
        position, steps = self._sequencer.position, self._plans.steps()
        if self._rest is None or self._rest[:2] != (position, id(steps)):
            self._rest = (position, id(steps), 0.0 if position is None else remaining_distance_m(steps, position))
        return self._rest[2]


def remaining_distance_m(steps: Sequence[Step], position: Position) -> float:
    """Length of a mission from the goal of ``position`` on. Jumps without an end are not made."""
    last, distance_m = None, 0.0
    for step in flown_order(steps, FAILSAFE_INPUTS.max_steps, position.cursor, position.jumps_done):
        place = getattr(step, "pos_ned_m", None)
        if place is not None:
            here = tuple(place.tolist())
            distance_m += 0.0 if last is None else math.dist(here, last)
            last = here
    return distance_m
