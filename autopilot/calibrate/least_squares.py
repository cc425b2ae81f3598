"""Robust least squares on time series, for the fits of this package."""

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.robust import MAD_TO_SIGMA

HUBER = 2.0
"""Standard deviations from which a residual counts only linearly."""
LEAST_SIGMA = 1e-12


def robust_sigma(residual: FloatArray) -> FloatArray:
    """Standard deviation of each column of (n, c) from the median of its absolute values."""
    return np.maximum(MAD_TO_SIGMA * np.median(np.abs(residual), axis=0), LEAST_SIGMA)


def huber_weights(residual: FloatArray, sigma: FloatArray) -> FloatArray:
    """Weights 1/sigma^2 of (n, c) residuals, reduced for outliers (Huber)."""
    scaled = np.abs(residual) / sigma
    return np.minimum(1.0, HUBER / np.maximum(scaled, LEAST_SIGMA)) / sigma**2


def solve_weighted(
    jacobian: FloatArray, residual: FloatArray, weights: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Step (p,) that makes residual - J step small, and the inverse information (p, p).

    ``jacobian`` (n, c, p), ``residual`` and ``weights`` (n, c), ``prior`` (p,) information on the step being zero."""
    p = jacobian.shape[2]
    flat, error, weight = jacobian.reshape(-1, p), residual.reshape(-1), weights.reshape(-1)
    information = flat.T @ (weight[:, None] * flat) + np.diag(prior)
    inverse: FloatArray = np.asarray(np.linalg.inv(information), dtype=np.float64)
    step: FloatArray = inverse @ (flat.T @ (weight * error))
    return step, inverse


def covariance(
    jacobian: FloatArray, residual: FloatArray, weights: FloatArray, inverse: FloatArray, lags: int
) -> FloatArray:
    """Covariance (p, p) when residuals up to ``lags`` rows apart are correlated (Newey and West 1987): overlapping
    increments share their ends, and consecutive frames see the same surface under the laser dot.
    """
    scores = np.einsum("ncp,nc->np", jacobian, weights * residual)
    middle = scores.T @ scores
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        middle += (1.0 - lag / (lags + 1)) * (cross + cross.T)
    result: FloatArray = inverse @ middle @ inverse
    # Negatively correlated residuals can make this smaller than noise alone would be: never accept less than a tenth.
    floor = 0.1 * np.diag(inverse)
    low = np.maximum(floor - np.diag(result), 0.0)
    result += np.diag(low)
    return result
