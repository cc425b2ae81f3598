"""Clipping of motion sensors: samples at the end of the range, which make the estimate drift.

The range is unknown to a log. A clipped axis shows the same extreme value several times in a row while other axes
vary; a frozen sensor repeats all axes and is not counted here.
"""

import numpy as np

from autopilot.core.frames import FloatArray

LEAST_RATE_RAD_S, LEAST_ACCEL_M_S2 = 1.0, 14.0
"""No sensor's range is smaller: below, equal values are steps of the digits."""
IN_A_ROW = 3


def clipped(rates_rad_s: FloatArray, accel_m_s2: FloatArray) -> tuple[int, int]:
    """How many samples (n, 3) have a turn rate, and how many a specific force, at the end of its range."""
    both = np.hstack((rates_rad_s, accel_m_s2))
    repeated = np.r_[False, (np.diff(both, axis=0) == 0.0).all(axis=1)] if len(both) else np.zeros(0, dtype=bool)
    fresh = ~repeated
    return _at_the_end(rates_rad_s[fresh], LEAST_RATE_RAD_S), _at_the_end(accel_m_s2[fresh], LEAST_ACCEL_M_S2)


def _at_the_end(values: FloatArray, least: float) -> int:
    found = np.zeros(len(values), dtype=bool)
    for axis in values.T:
        for side in (1.0, -1.0):
            largest = float((side * axis).max(initial=0.0))
            if largest >= least:
                found |= _in_a_row(side * axis == largest)
    return int(found.sum())


def _in_a_row(those: FloatArray) -> FloatArray:
    """(n,) which of those flags stand in a row that is long enough."""
    edges = np.flatnonzero(np.diff(np.r_[0, those.astype(np.int8), 0]))
    result = np.zeros(len(those), dtype=bool)
    for start, end in edges.reshape(-1, 2).tolist():
        result[start:end] = end - start >= IN_A_ROW
    return result
