"""A thruster is not turned round for next to nothing: where its thrust goes through zero it rests for a while."""

import numpy as np

from autopilot.core.frames import FloatArray

LEAST_SHARE = 0.035
"""Thrust against the way a thruster turned last, as a share of its limit, for which it is turned round: 0.4 N of 12 N,
less than half of the force that margins take for unmodelled anyway. What an estimate's noise asks for is less."""


class Reversals:
    """Which way every thruster turned last."""

    def __init__(self, limit_n: FloatArray) -> None:
        self._least_n = LEAST_SHARE * limit_n
        self._way = np.zeros(len(limit_n))

    def reset(self) -> None:
        """They stand still: either way is as good."""
        self._way[:] = 0.0

    def worth(self, thrust_n: FloatArray) -> FloatArray:
        """Thrust (n,) without what is not worth a reversal."""
        rests = (thrust_n * self._way < 0.0) & (np.abs(thrust_n) < self._least_n)
        result: FloatArray = np.where(rests, 0.0, thrust_n)
        np.copyto(self._way, np.sign(result), where=result != 0.0)
        return result
