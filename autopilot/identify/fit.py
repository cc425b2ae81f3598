"""Coefficients from windows of flight by the output-error method: the model is run from a start that is fitted, too.

Noise of the estimate then stands where it belongs, beside the prediction. Regressing accelerations on velocities
instead puts it into the regressors, which makes drag too small (errors in variables; Ljung, System Identification, 2nd
ed., 7.2 and 10.5). Each window of 4 s has its own start (8 numbers), eliminated by a
Schur complement, so that noise that accumulates is forgotten with every window.

Gauss-Newton, with noise per output from the residuals. Covariance by the sandwich formula with the windows as
clusters (White 1982): errors within a window may be correlated in any way.
"""

from dataclasses import dataclass

import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import AXES, NX, Model4
from autopilot.identify.prediction import (
    CURRENT_SCALE_M_S,
    N_COMMON,
    CoefficientScale,
    model_of,
    predict,
)
from autopilot.identify.record import STEP_S, Windows

FIRST_SIGMA = np.array([0.005, 0.005, 0.005, 0.005, 0.01])
"""Of x, y, z [m], yaw [rad], yaw rate [rad/s] in the first round."""

LEAST_SIGMA = np.array([0.0005, 0.0005, 0.0005, 0.0005, 0.001])

EVERY = 2
"""Only every n-th step is compared: neighbours are correlated."""

PRIOR = 3.0
"""Standard deviation of every coefficient before the flight, in its own scale: keeps finite what was not excited."""

LEAST_FRACTION = 0.05
"""Masses stay above this share of the base's."""

ROUNDS = 25
CONVERGED = 1e-4
NUDGE = 1e-4

START_SCALE = np.array([0.01, 0.01, 0.01, 0.01, 0.02, 0.02, 0.02, 0.02])
"""Units in which starts are counted."""

STUDENT_95 = ((5, 2.571), (10, 2.228), (20, 2.086), (30, 2.042), (60, 2.000), (120, 1.980))
"""Two-sided 95 % points of Student's distribution by degrees of freedom."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IdentificationFit:
    """The result. k coefficients: :data:`N_COMMON` and two components of the current per flight."""

    values: FloatArray
    """(14,) masses, linear drags, quadratic drags, buoyancy excess, arm of thrust to the side"""
    covariance: FloatArray
    """(14, 14)"""
    current_m_s: FloatArray
    """(flights, 2) north, east"""
    sigma: FloatArray
    """(5,) residual of x, y, z [m], yaw [rad], yaw rate [rad/s]"""
    student: float
    """Half width of a 95 % interval over the standard deviation."""
    windows: int
    rounds: int

    def model(self, like: Model4) -> Model4:
        return model_of(self.values, like)


@np.errstate(over="ignore", invalid="ignore")  # a search that runs away is reported as such
def fit(windows: Windows, like: Model4) -> IdentificationFit:
    """Fit all coefficients to all windows, beginning with those of ``like``.

    LogError if the search does not settle."""
    around, flights = CoefficientScale.of(like), int(windows.flight.max()) + 1
    theta = np.zeros(N_COMMON + 2 * flights)
    start, sigma = windows.start.copy(), FIRST_SIGMA.copy()
    last = np.inf
    for rounds in range(1, ROUNDS + 1):
        error, by_theta, by_start = _linearise(windows, like, around, theta, start)
        if rounds > 2:
            sigma = np.maximum(np.sqrt((error**2).mean(axis=(0, 1)) * _more(error, theta)), LEAST_SIGMA)
        step, moves, hessian, scores = _solve(
            error / sigma, by_theta / sigma[:, None], by_start / sigma[:, None], theta
        )
        bounded = _bounded(theta, step, around)
        theta, start = theta + bounded, start + moves * START_SCALE
        size = float(np.abs(step).max())
        if rounds > 3 and size < CONVERGED:
            break
        last = size
    else:
        if not last < 100.0 * CONVERGED:
            raise LogError("the coefficients do not settle; fly with more motion on every axis and fewer pushes")
    m = len(windows.motion)
    inverse = np.linalg.inv(hessian)
    spread = inverse @ (scores.T @ scores) @ inverse * m / max(1, m - len(theta))
    freedom = max(1, m - len(theta))
    student = next((value for count, value in STUDENT_95 if freedom <= count), 1.96)
    scale = around.scale
    return IdentificationFit(
        values=around.values(theta[:N_COMMON]),
        covariance=spread[:N_COMMON, :N_COMMON] * np.outer(scale, scale),
        current_m_s=CURRENT_SCALE_M_S * theta[N_COMMON:].reshape(flights, 2),
        sigma=sigma,
        student=student,
        windows=m,
        rounds=rounds,
    )


def _more(error: FloatArray, theta: FloatArray) -> float:
    """Degrees-of-freedom correction n / (n - parameters): residuals are smaller than errors."""
    n, fitted = int(error.size), error.shape[0] * NX + len(theta)
    return n / float(max(1, n - fitted))


def _linearise(
    windows: Windows, like: Model4, around: CoefficientScale, theta: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Measured minus predicted (m, t, 5) and the prediction's derivatives (m, t, 5, k) and (m, t, 5, 8)."""
    m, flights = len(start), (len(theta) - N_COMMON) // 2
    cases = 1 + N_COMMON + 2 + NX
    values = np.repeat(around.values(theta[:N_COMMON])[None], cases, axis=0)
    values[1 : 1 + N_COMMON] += NUDGE * np.diag(around.scale)
    own = CURRENT_SCALE_M_S * theta[N_COMMON:].reshape(flights, 2)[windows.flight]
    current = np.repeat(own[None], cases, axis=0)
    first = 1 + N_COMMON
    current[first, :, 0] += NUDGE * CURRENT_SCALE_M_S
    current[first + 1, :, 1] += NUDGE * CURRENT_SCALE_M_S
    starts = np.repeat(start[None], cases, axis=0)
    for k in range(NX):
        starts[first + 2 + k, :, k] += NUDGE * START_SCALE[k]
    inputs = np.broadcast_to(windows.inputs, (cases, *windows.inputs.shape))
    all_of_it = predict(values[:, None, :], like, starts, inputs, current, STEP_S)[:, :, ::EVERY]
    base = all_of_it[0]
    slopes = np.moveaxis((all_of_it[1:] - base) / NUDGE, 0, -1)
    by_theta = np.zeros((*base.shape, len(theta)))
    by_theta[..., :N_COMMON] = slopes[..., :N_COMMON]
    for n in range(m):
        place = N_COMMON + 2 * int(windows.flight[n])
        by_theta[n, ..., place : place + 2] = slopes[n, ..., N_COMMON : N_COMMON + 2]
    return windows.motion[:, ::EVERY] - base, by_theta, slopes[..., N_COMMON + 2 :]


def _solve(
    error: FloatArray, by_theta: FloatArray, by_start: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Gauss-Newton step, moves of the starts (m, 8), Hessian (k, k) and scores (m, k) with the starts eliminated."""
    m, k = len(error), len(theta)
    e = error.reshape(m, -1)
    a, b = by_theta.reshape(m, -1, k), by_start.reshape(m, -1, NX)
    bb = np.einsum("mri,mrj->mij", b, b)
    # The part of a and e that no start can explain.
    on_a = np.linalg.solve(bb, np.einsum("mri,mrj->mij", b, a))
    on_e = np.linalg.solve(bb, np.einsum("mri,mr->mi", b, e)[..., None])[..., 0]
    a = a - np.einsum("mri,mij->mrj", b, on_a)
    scores = np.einsum("mrk,mr->mk", a, e)
    hessian = np.einsum("mrk,mrj->kj", a, a) + np.eye(k) / PRIOR**2
    step = np.linalg.solve(hessian, scores.sum(axis=0) - theta / PRIOR**2)
    moves = on_e - np.einsum("mij,j->mi", on_a, step)
    return step, moves, hessian, scores


def _bounded(theta: FloatArray, step: FloatArray, around: CoefficientScale) -> FloatArray:
    """The step, cut so that masses stay positive, and drags nearly so."""
    result = step.copy()
    mass, drag = slice(0, AXES), slice(AXES, 3 * AXES)
    result[mass] = np.maximum(result[mass], LEAST_FRACTION - 1.0 - theta[mass])
    result[drag] = np.maximum(result[drag], -around.base[drag] / around.scale[drag] - theta[drag])
    return result
