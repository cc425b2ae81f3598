"""Station keeping without a solution of the optimiser.

Far from the goal the cascade of :mod:`autopilot.control.robust.fallback` brings the vehicle back slowly; inside the
terminal region of the goal the local law of :mod:`autopilot.control.robust.terminal` takes over: the region is
positively invariant, so that the vehicle stays in it.
"""

import math

import numpy as np

from autopilot.control.robust.fallback import station_keeping_thrust
from autopilot.control.robust.robust_tuning import ANCILLARY, STATION
from autopilot.control.robust.terminal import (
    CertificateJob,
    Terminal,
    TerminalLimits,
    region_error,
    terminal_law,
    unit_samples,
)
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal
from autopilot.core.model4 import YAW


class StationKeeper:
    """Holds one place after the other."""

    def __init__(self, allocator: ControlAllocator) -> None:
        self._allocator = allocator
        self._samples = unit_samples(STATION.hold_samples)
        self.target: FloatArray | None = None
        """(8,) the place that is held, None = none."""
        self._law: Terminal | None = None
        self._alpha = 0.0
        self._current = np.zeros(3)
        self._buoyancy_n = 0.0
        self.inside = False
        """The last command was that of the local law: the vehicle is in the invariant set."""

    def release(self) -> None:
        self.target, self._law, self.inside = None, None, False

    def thrust(self, x: FloatArray, current_ned_m_s: FloatArray, limit_n: FloatArray) -> FloatArray:
        """Thrust (n,) that holds the place where this began."""
        if self.target is None:
            self.target = x.copy()
        sunk_n = abs(self._allocator.buoyancy_excess_n - self._buoyancy_n)
        flows = float(np.abs(current_ned_m_s - self._current).max()) > STATION.current_step_m_s
        if self._law is None or flows or sunk_n > STATION.buoyancy_step_n:
            self._make(self.target, current_ned_m_s, limit_n)
        law = self._law
        self.inside = False
        if law is not None and self._alpha > 0.0:
            error = region_error(law, x, self.target[:3])
            if law.level(error) <= self._alpha:
                self.inside = True
                return np.clip(law.thrust_n + law.k @ error, -limit_n, limit_n)
        return station_keeping_thrust(self._allocator, x, self.target, current_ned_m_s, limit_n)

    def _make(self, target: FloatArray, current: FloatArray, limit_n: FloatArray) -> None:
        self._current, self._buoyancy_n = current.copy(), self._allocator.buoyancy_excess_n
        law = terminal_law(
            self._allocator,
            float(target[YAW]),
            current,
            np.array(ANCILLARY.state_weights),
            np.full(self._allocator.model.thrusters, ANCILLARY.thrust_weight),
            limit_n,
        )
        place = Goal(
            pos_ned_m=target[:3],
            yaw_rad=law.yaw_rad,
            speed_m_s=0.0,
            accept_radius_m=STATION.hold_radius_m,
            accept_yaw_rad=STATION.hold_yaw_rad,
            seq=-1,
        )
        limits = TerminalLimits(
            thrust_n=limit_n,
            planar_speed_m_s=STATION.hold_speed_m_s,
            heave_m_s=STATION.hold_heave_m_s,
            yaw_rate_rad_s=STATION.hold_yaw_rate_rad_s,
            depth_min_m=-math.inf,
            depth_max_m=math.inf,
            clearance_m=math.inf,
        )
        job = CertificateJob(self._allocator.model, law, place, limits, self._samples)
        while job.certificate is None:
            job.advance(STATION.hold_samples)
        self._law, self._alpha = law, job.certificate.alpha
