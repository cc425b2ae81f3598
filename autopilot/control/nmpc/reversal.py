"""A thruster is not turned round for next to nothing: where its thrust goes through zero it rests for a while."""

import math

import numpy as np

from autopilot.core.frames import FloatArray

LEAST_SHARE = 0.035
"""Thrust against the way a thruster turned last, as a share of its limit, for which it is turned round: 0.4 N of 12 N,
less than half of the force that margins take for unmodelled anyway. What an estimate's noise asks for is less."""


class Reversals:
    """Which way every thruster turned last."""

    def __init__(self, limit_n: FloatArray) -> None:
        self._least_n: list[float] = (LEAST_SHARE * limit_n).tolist()
        self._way = [0.0] * len(limit_n)

    def reset(self) -> None:
        """They stand still: either way is as good."""
        self._way = [0.0] * len(self._way)

    def worth(self, thrust_n: FloatArray) -> FloatArray:
        """Thrust (n,) without what is not worth a reversal."""
        worth: list[float] = thrust_n.tolist()
        for i, (thrust, least) in enumerate(zip(worth, self._least_n, strict=True)):
            if thrust * self._way[i] < 0.0 and abs(thrust) < least:
                worth[i] = 0.0
            elif thrust != 0.0:
                self._way[i] = math.copysign(1.0, thrust)
        return np.array(worth)
