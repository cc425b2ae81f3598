"""Ancillary feedback u = v + K (x - z), with K scheduled on the planned surge.

Above about 0.2 m/s ahead the sway-yaw pair is open-loop unstable (Munk moment, m22 > m11), and one gain for all speeds
is either weak or too aggressive. K is the LQR gain of the error dynamics at nine surge speeds, interpolated linearly.
The closed loop is stable at other sway and yaw rates on the whole envelope of speeds
(tests/control/test_robust_tube.py).
"""

import numpy as np

from autopilot.control.robust.error_model import error_jacobian, input_matrix
from autopilot.control.robust.riccati import dare, discretise, gain
from autopilot.control.robust.robust_tuning import ANCILLARY
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, Model4

SURGES_M_S = np.linspace(-0.8, 0.8, 9)
"""Surge speeds of the table; beyond, its ends."""


def lqr_gains(model: Model4) -> FloatArray:
    """(m, n, 8) LQR gains at SURGES_M_S (m,), other velocities zero."""
    a = np.array([error_jacobian(model, np.array([u, 0.0, 0.0, 0.0])) for u in SURGES_M_S])
    b = np.broadcast_to(input_matrix(model), (len(SURGES_M_S), NX, model.thrusters))
    a_d, b_d = discretise(a, b, ANCILLARY.design_step_s)
    r = ANCILLARY.thrust_weight * np.eye(model.thrusters)
    p = dare(a_d, b_d, np.diag(ANCILLARY.state_weights), r)
    return gain(a_d, b_d, p, r)


class Ancillary:
    """Feedback gain scheduled on planned surge."""

    def __init__(self, model: Model4) -> None:
        self.gains = lqr_gains(model)
        """(9, n, 8) at SURGES_M_S."""
        self._first, self._step = float(SURGES_M_S[0]), float(SURGES_M_S[1] - SURGES_M_S[0])

    def gain(self, surge_m_s: float) -> FloatArray:
        """K (n, 8) at a planned surge."""
        place = min(max((surge_m_s - self._first) / self._step, 0.0), len(self.gains) - 1.0)
        low = min(int(place), len(self.gains) - 2) if place > 0.0 else 0
        k: FloatArray = self.gains[low] + (place - low) * (self.gains[low + 1] - self.gains[low])
        return k
