"""Speed of the machine at the moment, so that figures of different days can be compared.

The reference is one prediction of filterpy's extended Kalman filter with 16 states: pure Python and small arrays,
as most of this service. It took 4.5 us on the machine and day on which the project's figures for speed were set.
"""

import time
from typing import Any

import numpy as np

REFERENCE_US = 4.5
"""The yardstick when the project's figures were set (two shared cores, Python 3.11, otherwise idle)."""

CALLS, ROUNDS = 2000, 7


def slowness() -> float:
    """CPU time of the reference task over its nominal time: 2 = half as fast. The best of a few rounds."""
    from filterpy.kalman import ExtendedKalmanFilter

    kalman = _yardstick(ExtendedKalmanFilter)
    best_s = float("inf")
    for _ in range(ROUNDS):
        begin_s = time.process_time()
        for _ in range(CALLS):
            kalman.predict()
        best_s = min(best_s, (time.process_time() - begin_s) / CALLS)
    return 1e6 * best_s / REFERENCE_US


def _yardstick(kind: type) -> Any:
    kalman = kind(16, 3)
    kalman.x = np.zeros(16)
    return kalman
