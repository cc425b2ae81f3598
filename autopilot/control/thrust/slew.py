"""Rate limit of thrust."""

import numpy as np

from autopilot.control.thrust.thrust_tuning import BY_HAND
from autopilot.core.frames import FloatArray


def slewed(wanted_n: FloatArray, last_n: FloatArray, limit_n: FloatArray, elapsed_s: float) -> FloatArray:
    """Thrust (n,) within ``limit_n`` (n,), no farther from ``last_n`` (n,) than it may change in ``elapsed_s``."""
    fraction = BY_HAND.slew_fraction_1_s * max(elapsed_s, 0.0)
    each = zip(wanted_n.tolist(), last_n.tolist(), limit_n.tolist(), strict=True)
    slow = [(min(max(wanted, last - fraction * limit), last + fraction * limit), limit) for wanted, last, limit in each]
    return np.array([min(max(thrust, -limit), limit) for thrust, limit in slow])
