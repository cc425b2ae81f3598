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


class Pace:
    """Interleaves the reference task with the work: load on a shared core slows both alike."""

    def __init__(self) -> None:
        from filterpy.kalman import ExtendedKalmanFilter

        self._kalman = _yardstick(ExtendedKalmanFilter)
        self._spent_s, self._calls = 0.0, 0

    def measure(self, calls: int = 20) -> None:
        begin_s = time.thread_time()
        for _ in range(calls):
            self._kalman.predict()
        self._spent_s += time.thread_time() - begin_s
        self._calls += calls

    @property
    def slowness(self) -> float:
        """Over all measurements so far; at least one."""
        return 1e6 * self._spent_s / self._calls / REFERENCE_US


def _yardstick(kind: type) -> Any:
    kalman = kind(16, 3)
    kalman.x = np.zeros(16)
    return kalman
