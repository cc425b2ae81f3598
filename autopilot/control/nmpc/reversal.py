"""Dead band at thrust reversal: small thrust against a thruster's last direction of rotation is set to zero."""

import math

import numpy as np

from autopilot.core.frames import FloatArray

LEAST_SHARE = 0.035
"""Dead band of reversal relative to the thrust limit: 0.4 N of 12 N, less than half of the unmodelled force that the
margins assume, and more than the noise of the estimate causes."""

BETWEEN = 2.0
"""Factor of the dead band between control steps: the inner loop's feedback has the noise of single ticks, of which one
in a few hundred would reverse an idle thruster. The next control step is 50 ms away."""


class Reversals:
    """Last direction of rotation of every thruster."""

    def __init__(self, limit_n: FloatArray) -> None:
        self._least_n: list[float] = (LEAST_SHARE * limit_n).tolist()
        self._direction = [0.0] * len(limit_n)

    def reset(self) -> None:
        """Thrusters at rest: either direction of rotation is allowed."""
        self._direction = [0.0] * len(self._direction)

    def worth(self, thrust_n: FloatArray, *, between: bool = False) -> FloatArray:
        """Thrust (n,) [N] after the dead band, which is wider ``between`` control steps (factor BETWEEN)."""
        worth: list[float] = thrust_n.tolist()
        fraction = BETWEEN if between else 1.0
        for i, (thrust, least) in enumerate(zip(worth, self._least_n, strict=True)):
            if thrust * self._direction[i] < 0.0 and abs(thrust) < fraction * least:
                worth[i] = 0.0
            elif thrust != 0.0:
                self._direction[i] = math.copysign(1.0, thrust)
        return np.array(worth)
