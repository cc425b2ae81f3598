"""The Kalman filter's covariance in C: prediction and update, the same as filterpy's in a tenth of the time."""

import ctypes
from typing import NamedTuple

import numpy as np

from autopilot.core.compiled import Mirror, library
from autopilot.core.frames import FloatArray
from autopilot.estimator.states import NX

MOST = 24
"""Residuals of one update: those of six sheets in a picture."""


class _Update(Mirror):
    """ctypes layout of the struct in estimator.c."""

    _fields_ = (
        ("m", ctypes.c_long),
        ("x", ctypes.c_double * NX),
        ("p", ctypes.c_double * (NX * NX)),
        ("residual", ctypes.c_double * MOST),
        ("jacobian", ctypes.c_double * (MOST * NX)),
        ("shared", ctypes.c_double * (NX * MOST)),
        ("noise", ctypes.c_double * (MOST * MOST)),
        ("inverse", ctypes.c_double * (MOST * MOST)),
        ("distance2", ctypes.c_double),
    )


class Updated(NamedTuple):
    """State and covariance after a measurement of m numbers, and what comes up on the way."""

    x: FloatArray
    """(21,)"""
    p: FloatArray
    """(21, 21)"""
    gain: FloatArray
    """(21, m)"""
    spread: FloatArray
    """(m, m) covariance of the residual, and its inverse."""
    inverse: FloatArray
    distance2: float
    """Squared Mahalanobis distance of the residual."""


class CompiledUpdate:
    """Functions of their arguments around one work space. :meth:`of_library` gives None where there is no library."""

    def __init__(self, compiled: ctypes.PyDLL) -> None:
        self._update, self._spread = compiled.kalman_update, compiled.spread_step
        self._work = _Update()
        self._address = ctypes.addressof(self._work)
        self._x, self._p = self._view("x"), self._view("p").reshape(NX, NX)
        self._views = [self._views_of(m) for m in range(MOST + 1)]
        self._before, self._after = np.zeros((NX, NX)), np.zeros((NX, NX))
        self._spread_addresses = self._before.ctypes.data, self._after.ctypes.data

    @staticmethod
    def of_library() -> "CompiledUpdate | None":
        compiled = library(_Update)
        return None if compiled is None else CompiledUpdate(compiled)

    def _view(self, name: str, count: int | None = None) -> FloatArray:
        return np.frombuffer(getattr(self._work, name), count=-1 if count is None else count)

    def _views_of(self, m: int) -> tuple[FloatArray, ...]:
        """Residual, Jacobian, noise, shared and inverse of m residuals."""
        shapes = {"jacobian": (m, NX), "noise": (m, m), "shared": (NX, m), "inverse": (m, m)}
        return (
            self._view("residual", m),
            *(self._view(name, rows * columns).reshape(rows, columns) for name, (rows, columns) in shapes.items()),
        )

    def spread(self, jacobian_address: int, p: FloatArray, noise_address: int) -> FloatArray:
        """F P F' + Q, a new array (21, 21), by the addresses of F (21, 21) and of the diagonal of Q (21,)."""
        before, after = self._spread_addresses
        self._before[:] = p
        self._spread(jacobian_address, before, noise_address, after)
        return self._after.copy()

    def update(
        self,
        x: FloatArray,
        p: FloatArray,
        residual: FloatArray,
        jacobian: FloatArray,
        noise: FloatArray,
        shared: FloatArray | float = 0.0,
    ) -> Updated:
        """The update by m residuals (m,) with their Jacobian (m, 21) and noise (m, m), at most :data:`MOST`.

        ``shared`` (21, m): covariance of the state with the noise. LinAlgError where filterpy raises it."""
        m = len(residual)
        y, h, r, t, inverse = self._views[m]
        self._work.m = m
        self._x[:], self._p[:], y[:], h[:], r[:], t[:] = x, p, residual, jacobian, noise, shared
        if not self._update(self._address):
            raise np.linalg.LinAlgError("the covariance of the residual is singular")
        return Updated(self._x.copy(), self._p.copy(), t.copy(), r.copy(), inverse.copy(), self._work.distance2)
