"""Riccati and Lyapunov equations in numpy, for stacks of systems. SciPy has both, but its import costs the controller
memory and start-up time.
"""

import numpy as np

from autopilot.core.frames import FloatArray

DOUBLINGS = 60
"""Squarings at most: 2^60 steps are for ever."""

TOLERANCE = 1e-13
"""Relative change at which a doubling has converged."""


def exponential(a: FloatArray) -> FloatArray:
    """e^a of matrices (..., n, n): Taylor to order 10 after halving to a norm below 1/2, then squared back."""
    norm = float(np.abs(a).sum(axis=-1).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(norm / 0.5)))) if norm > 0.5 else 0
    small = a / 2.0**halvings
    result = np.broadcast_to(np.eye(a.shape[-1]), a.shape).copy()
    term = result.copy()
    for order in range(1, 11):
        term = term @ small / order
        result = result + term
    for _ in range(halvings):
        result = result @ result
    return result


def discretise(a: FloatArray, b: FloatArray, h_s: float) -> tuple[FloatArray, FloatArray]:
    """Zero-order hold over ``h_s`` of x' = a x + b u, a (..., n, n), b (..., n, m) (Van Loan 1978)."""
    n, m = b.shape[-2:]
    block = np.zeros((*a.shape[:-2], n + m, n + m))
    block[..., :n, :n], block[..., :n, n:] = a, b
    power = exponential(block * h_s)
    return power[..., :n, :n], power[..., :n, n:]


def dare(a: FloatArray, b: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    """Stabilising solution P of P = a'P a - a'P b (r + b'P b)^-1 b'P a + q.

    Structured doubling (Chu, Fan, Lin and Wang 2004): quadratic convergence. All arguments may be stacks.
    """
    n = a.shape[-1]
    eye = np.eye(n)
    g = b @ np.linalg.solve(np.broadcast_to(r, (*b.shape[:-2], *r.shape[-2:])), np.swapaxes(b, -1, -2))
    h = np.broadcast_to(q, a.shape).copy()
    for _ in range(DOUBLINGS):
        w = np.linalg.inv(eye + g @ h)
        aw, at = a @ w, np.swapaxes(a, -1, -2)
        step = at @ h @ w @ a
        g = g + aw @ g @ at
        h = h + step
        a = aw @ a
        if np.abs(step).max() <= TOLERANCE * np.abs(h).max():
            break
    return 0.5 * (h + np.swapaxes(h, -1, -2))


def gain(a: FloatArray, b: FloatArray, p: FloatArray, r: FloatArray) -> FloatArray:
    """LQR gain K (..., m, n) of u = K x for the solution ``p`` of :func:`dare`: K = -(r + b'P b)^-1 b'P a."""
    bt_p = np.swapaxes(b, -1, -2) @ p
    return np.asarray(-np.linalg.solve(r + bt_p @ b, bt_p @ a), dtype=float)


def lyapunov(a: FloatArray, q: FloatArray) -> FloatArray:
    """P = a P a' + q for Schur-stable ``a`` (doubling)."""
    p, power = q.copy(), a
    for _ in range(DOUBLINGS):
        step = power @ p @ np.swapaxes(power, -1, -2)
        np.add(p, step, out=p)
        power = power @ power
        if np.abs(step).max() <= TOLERANCE * np.abs(p).max():
            break
    return p
