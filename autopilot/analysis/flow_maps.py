"""Benchmark B6's current on a grid, and what a forecast of a current gets wrong: both free of divergence.

Everything is made from streamfunctions that live in the middle of the grid's cells, psi at (i + 1/2, j + 1/2):

    u_ij =  (psi_{i+1/2,j+1/2} + psi_{i-1/2,j+1/2} - psi_{i+1/2,j-1/2} - psi_{i-1/2,j-1/2}) / 2h
    v_ij = -(psi_{i+1/2,j+1/2} + psi_{i+1/2,j-1/2} - psi_{i-1/2,j+1/2} - psi_{i-1/2,j-1/2}) / 2h

With these the interpolated field carries no net water into any cell: the trapezoidal flows through its four sides add
up to zero but for rounding.
"""

import io
import math
from dataclasses import dataclass, replace

import numpy as np

from autopilot.core.frames import FloatArray

LENGTH_M, WIDTH_M, CELL_M = 400.0, 200.0, 5.0
FRAME_S, LAST_S = 60.0, 2400.0
MEAN_M_S, TIDE_M_S, TIDE_PERIOD_S = 0.10, 0.15, 1800.0
EDDY_SPEED_M_S, EDDY_RADIUS_M = 0.2, 30.0
EDDIES = ((130.0, 75.0, 1.0), (250.0, 125.0, -1.0))
"""Centre at time zero, north and east [m]; +1 turns from north to east."""
DRIFT_M_S = 0.02
"""Eddies go along x with the mean flow."""

ERROR_LENGTH_M = 10.0
"""Correlation length L of the forecast's error: its streamfunction has the covariance exp(-r^2 / 2 L^2)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FlowMap:
    """Arrays as a map file holds them."""

    time_s: FloatArray
    """(k,)"""
    north_m: FloatArray
    """(a,)"""
    east_m: FloatArray
    """(b,)"""
    current_north_m_s: FloatArray
    """(k, a, b)"""
    current_east_m_s: FloatArray
    """(k, a, b)"""

    @property
    def rms_m_s(self) -> float:
        """Root mean square of the speed."""
        return math.sqrt(float(np.mean(self.current_north_m_s**2 + self.current_east_m_s**2)))


def b6_map() -> FlowMap:
    """400 x 200 m, 5 m cells, frames of 60 s: a mean flow along x with a tide, and two drifting eddies."""
    time_s = np.arange(0.0, LAST_S + 0.5 * FRAME_S, FRAME_S)
    north_m, east_m = _axis(LENGTH_M), _axis(WIDTH_M)
    x, y = np.meshgrid(_middles(north_m), _middles(east_m), indexing="ij")
    frames = []
    for t in time_s:
        psi = (MEAN_M_S + TIDE_M_S * math.sin(2.0 * math.pi * t / TIDE_PERIOD_S)) * y
        for north, east, sense in EDDIES:
            r2 = (x - north - DRIFT_M_S * t) ** 2 + (y - east) ** 2
            # Speed A r / R^2 exp(-r^2 / 2R^2) has its maximum A / (R sqrt(e)) at r = R.
            amplitude = EDDY_SPEED_M_S * EDDY_RADIUS_M * math.exp(0.5)
            psi = psi + sense * amplitude * np.exp(-r2 / (2.0 * EDDY_RADIUS_M**2))
        frames.append(_flow(psi))
    u, v = np.array([f[0] for f in frames]), np.array([f[1] for f in frames])
    return FlowMap(time_s=time_s, north_m=north_m, east_m=east_m, current_north_m_s=u, current_east_m_s=v)


def forecast_of(truth: FlowMap, *, error: float, rng: np.random.Generator) -> FlowMap:
    """The truth plus a steady smooth random flow whose root mean square is ``error`` (0.1 to 0.3) of the truth's."""
    from scipy.ndimage import gaussian_filter

    cell_m = float(truth.north_m[1] - truth.north_m[0])
    shape = (len(truth.north_m) + 1, len(truth.east_m) + 1)
    # White noise through a Gaussian of L / sqrt(2) has the covariance exp(-r^2 / 2 L^2).
    psi = gaussian_filter(rng.standard_normal(shape), ERROR_LENGTH_M / math.sqrt(2.0) / cell_m, mode="nearest")
    u, v = _flow(psi * cell_m, cell_m)
    scale = error * truth.rms_m_s / math.sqrt(float(np.mean(u**2 + v**2)))
    return replace(
        truth,
        current_north_m_s=truth.current_north_m_s + scale * u,
        current_east_m_s=truth.current_east_m_s + scale * v,
    )


def flow_map_bytes(flow: FlowMap) -> bytes:
    """As ``.npz`` in single precision; the same map gives the same bytes."""
    content = io.BytesIO()
    np.savez_compressed(
        content,
        time_s=flow.time_s,
        north_m=flow.north_m,
        east_m=flow.east_m,
        current_north_m_s=flow.current_north_m_s.astype(np.float32),
        current_east_m_s=flow.current_east_m_s.astype(np.float32),
    )
    return content.getvalue()


def _axis(length_m: float) -> FloatArray:
    return np.linspace(0.0, length_m, round(length_m / CELL_M) + 1)


def _middles(axis: FloatArray) -> FloatArray:
    """(n + 1,) half a cell round every node."""
    half = 0.5 * (axis[1] - axis[0])
    return np.concatenate((axis - half, axis[-1:] + half))


def _flow(psi: FloatArray, cell_m: float = CELL_M) -> tuple[FloatArray, FloatArray]:
    """North and east velocity at the nodes (a, b) of a streamfunction (a + 1, b + 1) in between."""
    across, along = np.diff(psi, axis=1), np.diff(psi, axis=0)
    u = (across[1:] + across[:-1]) / (2.0 * cell_m)
    v = -(along[:, 1:] + along[:, :-1]) / (2.0 * cell_m)
    return u, v
