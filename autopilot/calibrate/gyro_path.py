"""The rotation that the gyros saw: integrated once, asked for between any two times."""

import numpy as np
from scipy.spatial.transform import Rotation

from autopilot.calibrate.recorded_flight import RecordedAhrs
from autopilot.core.frames import FloatArray

MAX_GAP_S = 0.1
"""Over longer gaps in the AHRS's samples nothing is known."""


class GyroPath:
    """Attitude relative to the first sample, by integration of the gyro."""

    def __init__(self, ahrs: RecordedAhrs, bias_rad_s: FloatArray) -> None:
        """``bias_rad_s`` (3,) is taken off the gyros; later is too late, for it turns with the vehicle."""
        self._t_s = ahrs.t_s
        self._rate = ahrs.rate_frd_rad_s - bias_rad_s
        dt_s = np.diff(ahrs.t_s)
        steps = Rotation.from_rotvec(0.5 * (self._rate[1:] + self._rate[:-1]) * dt_s[:, None])
        path = np.empty((len(ahrs.t_s), 4))
        path[0] = (0.0, 0.0, 0.0, 1.0)
        quats = steps.as_quat()
        for n in range(len(quats)):
            path[n + 1] = _times(path[n], quats[n])
        self._path = Rotation.from_quat(path)
        self._gap = np.concatenate(([0], np.cumsum(dt_s > MAX_GAP_S)))

    def covers(self, begin_s: FloatArray, end_s: FloatArray) -> np.ndarray:
        """(n,) whether there are samples without a gap from before the one to after the other time."""
        first = np.searchsorted(self._t_s, begin_s, side="right") - 1
        last = np.searchsorted(self._t_s, end_s, side="left")
        inside = (first >= 0) & (last < len(self._t_s))
        last = np.minimum(last, len(self._t_s) - 1)
        result: np.ndarray = inside & (self._gap[last] == self._gap[np.maximum(first, 0)])
        return result

    def at(self, t_s: FloatArray) -> Rotation:
        """Attitudes at times that are covered."""
        n = np.clip(np.searchsorted(self._t_s, t_s, side="right") - 1, 0, len(self._t_s) - 2)
        after_s = t_s - self._t_s[n]
        fraction = after_s / (self._t_s[n + 1] - self._t_s[n])
        mean_rate = self._rate[n] + 0.5 * fraction[:, None] * (self._rate[n + 1] - self._rate[n])
        return self._path[n] * Rotation.from_rotvec(mean_rate * after_s[:, None])

    def increments(self, begin_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """(n, 3) rotation vectors from each begin to each end, body frame at the begin."""
        return (self.at(begin_s).inv() * self.at(end_s)).as_rotvec()


def _times(a: FloatArray, b: FloatArray) -> FloatArray:
    """Product of two quaternions [x, y, z, w]."""
    ax, ay, az, aw = a.tolist()
    bx, by, bz, bw = b.tolist()
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )
