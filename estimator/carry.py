"""Update of the nodes after a late measurement, without repeating their predictions and updates.

One update changes x and P at low rank: x by W e and P by -W C W', with W the gain, C the covariance of the residual
and e the residual. A prediction propagates W by its Jacobian. A later update keeps that form: with its gain K,
Jacobian H, residual y and innovation covariance S, and V = (H W)',

    S' = S - V' C V     W' = W - K V'     C' = C + C V S'^-1 V' C     e' = e + C V S'^-1 (V' e - y)
    y' = y - V' e       K' = K - W' C V S'^-1

are those of the repeated update (insert P - W C W' and x + W e into the filter's equations). The result equals full
recomputation except that Jacobians are those of the previous states, a second-order error in the correction. Larger
corrections are recomputed (:data:`LINEAR`).
"""

import operator
from typing import NamedTuple

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.estimator.states import CURRENT, DRAG_EXCESS, NX, VEL, YAW, FilterState

LINEAR: FloatArray = np.full(NX, np.inf)
LINEAR[YAW], LINEAR[VEL], LINEAR[CURRENT], LINEAR[DRAG_EXCESS] = 0.002, 0.006, 0.008, 0.02
"""(21,) A state that is corrected by more turns or drags otherwise than the Jacobians say."""
MOST_COLUMNS = 12
"""With more, computing again is cheaper."""


class PastUpdate(NamedTuple):
    """An update that has been made."""

    gain: FloatArray
    """(21, m)"""
    jacobian: FloatArray
    """(m, 21)"""
    spread: FloatArray
    """(m, m) covariance of the residual."""
    y: FloatArray
    """(m,) residual."""


class Correction(NamedTuple):
    """x changes by W e, the covariance by -W C W'."""

    w: FloatArray
    """(21, k)"""
    c: FloatArray
    """(k, k)"""
    e: FloatArray
    """(k,)"""

    @property
    def small(self) -> bool:
        """Whether the correction is small enough for the Jacobians to hold."""
        if len(self.e) > MOST_COLUMNS:
            return False
        change = np.abs(self.w.dot(self.e)).tolist()
        return all(map(operator.le, change, LINEAR.tolist()))

    def joined(self, other: "Correction") -> "Correction":
        """First this one, then the other at the same node."""
        k, m = len(self.e), len(other.e)
        c = np.zeros((k + m, k + m))
        c[:k, :k], c[k:, k:] = self.c, other.c
        return Correction(np.concatenate((self.w, other.w), axis=1), c, np.concatenate((self.e, other.e)))

    def through(self, update: PastUpdate) -> tuple["Correction", PastUpdate]:
        """The correction after a later update, and that update with the correction included."""
        w, c, e = self
        v = update.jacobian.dot(w).T
        cv = c.dot(v)
        spread = symmetric(update.spread - v.T.dot(cv))
        pull = cv.dot(np.linalg.inv(spread))
        behind = w - update.gain.dot(v.T)
        known = v.T.dot(e)
        after = Correction(behind, symmetric(c + pull.dot(cv.T)), e + pull.dot(known - update.y))
        return after, PastUpdate(update.gain - behind.dot(pull), update.jacobian, spread, update.y - known)

    def on(self, state: FilterState) -> FilterState:
        return FilterState(state.x + self.w.dot(self.e), symmetric(state.p - self.w.dot(self.c).dot(self.w.T)))


def symmetric(p: FloatArray) -> FloatArray:
    """The mean of a matrix and its transpose: rounding asymmetry would grow from fix to fix."""
    result: FloatArray = p + p.T
    result *= 0.5
    return result
