"""Stabilisation of roll and pitch for vehicles whose thrusters can produce these moments: an inner loop on the AHRS.

The controller commands surge, sway, heave and yaw only. Thrusters above or below the centre of gravity couple into
roll and pitch, and the restoring moment of a heavy frame is small. This loop adds thrust in the null space of the four
controlled axes that produces roll and pitch moments: feedforward cancels the coupling of the controller's thrust, PD
feedback levels the vehicle.

M = -I (w^2 angle + 2 w rate) - coupling, with inertia I and natural frequency w (critically damped). The thrust
reserved for it (:meth:`AttitudeStabilizer.reserve_n`) is not available to the controller.
"""

import math

import numpy as np

from autopilot.control.thrust.thrust_tuning import ATTITUDE_STABILISATION
from autopilot.core.frames import FloatArray
from autopilot.core.thrusters import CONTROLLED, wrench_matrix
from autopilot.core.vehicle import Vehicle

LEVEL_RAD = math.radians(2.0)
"""Within so much of level, in roll and pitch, levelling alone turns no thruster round ..."""


MOST_TILT_RAD = math.radians(60.0)
"""Beyond this an angle counts as so much."""


class AttitudeStabilizer:
    """The loop of one vehicle; does nothing for one without ``[levelling]`` or without the thrusters for it."""

    def __init__(self, vehicle: Vehicle) -> None:
        thrusters, table = vehicle.thrusters, vehicle.levelling
        places, directions = [t.position_frd_m for t in thrusters], [t.direction_frd for t in thrusters]
        wrench = np.array(wrench_matrix(places, directions))
        self._controlled, self._tilt = wrench[list(CONTROLLED)], wrench[3:5]
        self._inertia = np.zeros(2) if table is None else np.array(table.inertia_kg_m2)
        self._rate_rad_s = 0.0 if table is None else table.natural_rad_s
        self.given = table is not None
        """Whether there is anything to do."""
        self._patterns: dict[bytes, FloatArray] = {}
        self._least_n = ATTITUDE_STABILISATION.least_fraction * np.array([t.limit_n for t in thrusters])
        self._turned = np.zeros(len(thrusters))
        """Which way each turned last."""

    def reserve_n(self, limit_n: FloatArray) -> FloatArray:
        """(n,) part of ``limit_n`` (n,) [N], 0 for a failed thruster, that is reserved.

        Enough to cancel the roll and pitch moment of all others at their limits, at most
        :data:`ATTITUDE_STABILISATION.most` of the thruster's own limit.
        """
        if not self.given:
            return np.zeros_like(limit_n)
        patterns = self._patterns_for(limit_n)
        levels = np.abs(patterns).max(axis=1) > 0.0
        worst = np.abs(self._tilt) @ np.where(levels, 0.0, limit_n)
        reserve: FloatArray = np.minimum(ATTITUDE_STABILISATION.most * limit_n, np.abs(patterns) @ worst) * levels
        return reserve

    def thrust_n(
        self, wanted_n: FloatArray, limit_n: FloatArray, rpy_rad: FloatArray, rate_frd_rad_s: FloatArray
    ) -> FloatArray:
        """(n,) ``wanted_n`` plus the stabilising thrust, within ``limit_n`` [N]; at saturation the stabilising part is
        scaled so that the four controlled axes are unaffected.
        """
        patterns = self._patterns_for(limit_n) if self.given else None
        if patterns is None or not patterns.any():
            return wanted_n
        angle = np.clip(rpy_rad[:2], -MOST_TILT_RAD, MOST_TILT_RAD)
        w = self._rate_rad_s
        moment = -self._inertia * (w * w * angle + 2.0 * w * rate_frd_rad_s[:2]) - self._tilt @ wanted_n
        more = patterns @ moment
        used = np.abs(more) > ATTITUDE_STABILISATION.small
        if not used.any() or not np.isfinite(more).all():
            return wanted_n
        capacity = (limit_n - wanted_n * np.sign(more))[used] / np.abs(more)[used]
        fraction = min(1.0, max(0.0, float(capacity.min())))
        result: FloatArray = wanted_n + fraction * more
        if float(np.abs(angle * patterns.any(axis=0)).max()) < LEVEL_RAD:
            result = self._unturned(wanted_n, fraction * more, result)
        turns = np.abs(result) > ATTITUDE_STABILISATION.small
        self._turned[turns] = np.sign(result[turns])
        return result

    def _unturned(self, wanted_n: FloatArray, more_n: FloatArray, result: FloatArray) -> FloatArray:
        """(n,) with ``more_n`` (n,) reduced where it would reverse a thruster within the dead band: that one is set to
        zero or to the controller's thrust, which has its own dead band.
        """
        for _ in more_n:
            back = (result * self._turned < 0.0) & (np.abs(result) < self._least_n) & (wanted_n * more_n <= 0.0)
            back &= (np.abs(result) > ATTITUDE_STABILISATION.small) & (result * more_n > 0.0)
            if not back.any():
                break
            more_n = more_n * float((np.abs(wanted_n)[back] / np.abs(more_n)[back]).min())
            result = wanted_n + more_n
        return result

    def _patterns_for(self, limit_n: FloatArray) -> FloatArray:
        """(n, 2) thrust for 1 N m about roll and pitch by the available thrusters; 0 for moments that they cannot
        produce.
        """
        key = (limit_n > 0.0).tobytes()
        if key not in self._patterns:
            self._patterns[key] = self._found(limit_n > 0.0) if self.given else np.zeros((len(limit_n), 2))
        return self._patterns[key]

    def _found(self, alive: np.ndarray) -> FloatArray:
        """Least-squares solution; a tilt that needs force in another axis is not controlled."""
        patterns = np.zeros((len(alive), 2))
        pushed = np.vstack([self._controlled, self._tilt]) * alive
        inverse = np.linalg.pinv(pushed, rcond=ATTITUDE_STABILISATION.small)
        for tilt in range(2):
            pattern = inverse[:, 4 + tilt] * alive
            effect = pushed @ pattern
            effect[4 + tilt] -= 1.0
            if float(np.abs(effect).max()) < 1e-3:
                patterns[:, tilt] = np.where(np.abs(pattern) > ATTITUDE_STABILISATION.small, pattern, 0.0)
        return patterns
