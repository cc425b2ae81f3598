"""Mean square of what goes to and fro, as waves do."""

import numpy as np

from autopilot.core.frames import FloatArray


class ToAndFro:
    """Of an axis the weaker direction counts: what starts to flow, or a jet that is entered, is no wave."""

    def __init__(self) -> None:
        self._squares = np.zeros((2, 2))
        """Mean squares of what is positive and of what is negative, by axis."""

    def update(self, gain: float, values: FloatArray) -> float:
        """Take in ``values`` (2,) with the weight ``gain``; the mean square, of the stronger axis."""
        self._squares += gain * (np.square(np.maximum([values, -values], 0.0)) - self._squares)
        return 2.0 * float(self._squares.min(axis=0).max())
