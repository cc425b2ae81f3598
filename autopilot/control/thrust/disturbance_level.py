"""Level of the disturbances that not even the likeliest delay of commands explains: waves, a tether that jerks.

Covariance matching (Mehra 1970): where the innovations are larger than the filter expects, its disturbance is made
larger until they are not. Waves push the same way for a second and the controller pushes back, so that late commands
explain a part of them: evidence counts for less, the higher the level.
"""

import numpy as np

from autopilot.control.thrust.thrust_tuning import DISTURBANCE_LEVEL
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import AXES


class DisturbanceLevel:
    """Factors of the variance of disturbances, by axis; 1 where they are as the filters' beliefs have them."""

    def __init__(self) -> None:
        self.factor: FloatArray = np.ones(AXES)
        """(4,)"""

    @property
    def evidence_share(self) -> float:
        """What evidence counts for, 1 to 0."""
        beyond = (float(self.factor.max()) - 1.0) / (DISTURBANCE_LEVEL.silent - 1.0)
        return max(0.0, 1.0 - beyond)

    def update(self, dt_s: float, innovation: FloatArray, s: FloatArray) -> None:
        """``innovation`` (4,) of the likeliest candidate, and its covariance ``s`` (4, 4)."""
        tuning = DISTURBANCE_LEVEL
        ratio = np.minimum(np.square(innovation) / np.diag(s), tuning.most_ratio)
        grown = np.exp(dt_s / tuning.follow_s * (ratio - 1.0))
        self.factor = np.clip(self.factor * grown, 1.0, tuning.most)
