"""Stabilisation of roll and pitch for vehicles whose thrusters can produce these moments: an inner loop on the AHRS.

The controller commands surge, sway, heave and yaw only. Thrusters above or below the centre of gravity couple into
roll and pitch, and the restoring moment of a heavy frame is small. This loop adds thrust in the null space of the four
controlled axes that produces roll and pitch moments: feedforward cancels the coupling of the controller's thrust, PD
feedback levels the vehicle.

M = -I (w^2 angle + 2 w rate) - coupling, with inertia I and natural frequency w (critically damped). The thrust
reserved for it (:meth:`AttitudeStabilizer.reserve_n`) is not available to the controller.

A tilt that no thruster pushes alone is left to the restoring moment, which swings: the pitch of a BlueROV2, whose surge
thrusters stand 85 mm below its centre of gravity. Its swing is damped by the same thrusters, M = -2 d I w rate. What
tilt is left turns the thrust: the force that the controller wants in the level frame is turned into the body.
"""

import math
from typing import NamedTuple

import numpy as np

from autopilot.control.thrust.thrust_tuning import ATTITUDE_STABILISATION
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.thrusters import CONTROLLED, wrench_matrix
from autopilot.core.vehicle import Vehicle

LEVEL_RAD = math.radians(2.0)
"""Within so much of level, in roll and pitch, levelling alone turns no thruster round ..."""


SWUNG_BY = (1, 0)
"""Axis of force whose thrusters tilt roll and pitch: sway and surge."""

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
        self._patterns: dict[bytes, _Patterns] = {}
        self._least_n = ATTITUDE_STABILISATION.least_fraction * np.array([t.limit_n for t in thrusters])
        self._swing_rad_s = np.zeros(2)
        """Rates of roll and pitch without the gyro's noise."""
        self._turned = np.zeros(len(thrusters))
        """Which way each turned last."""

    def reserve_n(self, limit_n: FloatArray) -> FloatArray:
        """(n,) part of ``limit_n`` (n,) [N], 0 for a failed thruster, that is reserved.

        Enough to cancel the roll and pitch moment of all others at their limits, at most
        :data:`ATTITUDE_STABILISATION.most` of the thruster's own limit.
        """
        if not self.given:
            return np.zeros_like(limit_n)
        patterns = self._patterns_for(limit_n).levelling
        levels = np.abs(patterns).max(axis=1) > 0.0
        worst = np.abs(self._tilt) @ np.where(levels, 0.0, limit_n)
        reserve: FloatArray = np.minimum(ATTITUDE_STABILISATION.most * limit_n, np.abs(patterns) @ worst) * levels
        return reserve

    def thrust_n(
        self,
        wanted_n: FloatArray,
        limit_n: FloatArray,
        command_limit_n: FloatArray,
        rpy_rad: FloatArray,
        rate_frd_rad_s: FloatArray,
    ) -> FloatArray:
        """(n,) ``wanted_n`` plus the stabilising thrust, within ``limit_n`` [N]; at saturation the stabilising part is
        scaled so that the four controlled axes are unaffected. ``command_limit_n`` (n,) binds what damps.
        """
        if not self.given:
            return wanted_n
        found = self._patterns_for(limit_n)
        wanted_n = self._upright(wanted_n, limit_n, found.forces, rpy_rad)
        wanted_n = self._damped(wanted_n, command_limit_n, found.damping, rate_frd_rad_s)
        patterns = found.levelling
        if not patterns.any():
            return wanted_n
        angle = np.clip(rpy_rad[:2], -MOST_TILT_RAD, MOST_TILT_RAD)
        w = self._rate_rad_s
        moment = -self._inertia * (w * w * angle + 2.0 * w * rate_frd_rad_s[:2]) - self._tilt @ wanted_n
        more = patterns @ moment
        fraction = _fraction(more, limit_n - wanted_n * np.sign(more))
        if fraction == 0.0:
            return wanted_n
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

    def _upright(
        self, wanted_n: FloatArray, limit_n: FloatArray, forces: FloatArray, rpy_rad: FloatArray
    ) -> FloatArray:
        """(n,) with which the tilted vehicle is pushed as ``wanted_n`` pushes a level one."""
        roll, pitch = (min(max(angle, -MOST_TILT_RAD), MOST_TILT_RAD) for angle in rpy_rad[:2].tolist())
        force = self._controlled[:3] @ wanted_n
        more: FloatArray = forces @ (r_ned_from_frd(np.array((roll, pitch, 0.0))).T @ force - force)
        fraction = _fraction(more, limit_n - wanted_n * np.sign(more))
        return wanted_n + fraction * more if fraction else wanted_n

    def _damped(
        self, wanted_n: FloatArray, limit_n: FloatArray, patterns: FloatArray, rate_frd_rad_s: FloatArray
    ) -> FloatArray:
        """(n,) with the thrust that damps the tilts which swing freely; it turns no thruster round."""
        swing = self._swing_rad_s + ATTITUDE_STABILISATION.swing_gain * (rate_frd_rad_s[:2] - self._swing_rad_s)
        if not all(map(math.isfinite, swing.tolist())):
            return wanted_n
        self._swing_rad_s = swing
        damping = 2.0 * ATTITUDE_STABILISATION.damping * self._rate_rad_s * self._inertia
        more: FloatArray = patterns @ (-damping * swing)
        opposed = wanted_n * more < 0.0
        fraction = _fraction(more, np.where(opposed, np.abs(wanted_n), limit_n - np.abs(wanted_n)))
        return wanted_n + fraction * more if fraction else wanted_n

    def _patterns_for(self, limit_n: FloatArray) -> "_Patterns":
        """Of the thrusters that can push."""
        alive = limit_n > 0.0
        key = alive.tobytes()
        if key not in self._patterns:
            self._patterns[key] = self._found(alive)
        return self._patterns[key]

    def _found(self, alive: np.ndarray) -> "_Patterns":
        """Least-squares solutions, of forces only if every axis can be pushed."""
        levelling, damping = np.zeros((len(alive), 2)), np.zeros((len(alive), 2))
        pushed = np.vstack([self._controlled, self._tilt]) * alive
        both = np.linalg.pinv(pushed, rcond=ATTITUDE_STABILISATION.small)
        forces = np.linalg.pinv(pushed[:4], rcond=ATTITUDE_STABILISATION.small) * alive[:, None]
        if float(np.abs(pushed[:4] @ forces - np.eye(4)).max()) > 1e-3:
            forces[:] = 0.0
        for tilt in range(2):
            pattern, effect = both[:, 4 + tilt] * alive, np.eye(6)[4 + tilt]
            if float(np.abs(pushed @ pattern - effect).max()) < 1e-3:
                levelling[:, tilt] = pattern
                continue
            force = forces[:, SWUNG_BY[tilt]]
            lever_m = float(pushed[4 + tilt] @ force)
            if abs(lever_m) > ATTITUDE_STABILISATION.least_lever_m:
                damping[:, tilt] = force / lever_m
        small = ATTITUDE_STABILISATION.small
        return _Patterns(*(np.where(np.abs(one) > small, one, 0.0) for one in (levelling, damping, forces[:, :3])))


def _fraction(more_n: FloatArray, room_n: FloatArray) -> float:
    """Share of ``more_n`` (n,) for which there is room (n,)."""
    share, used = 1.0, False
    for more, room in zip(np.abs(more_n).tolist(), room_n.tolist(), strict=True):
        if more > ATTITUDE_STABILISATION.small:
            share, used = min(share, room / more) if room > 0.0 else 0.0, True
        if not math.isfinite(more):
            return 0.0
    return share if used else 0.0


class _Patterns(NamedTuple):
    """(n, 2) thrust for 1 N m about roll and pitch by the available thrusters, 0 where they cannot."""

    levelling: FloatArray
    """Without force or yaw moment."""
    damping: FloatArray
    """By sway and surge, for tilts without the other."""
    forces: FloatArray
    """(n, 3) for 1 N of surge, sway and heave."""
