"""Bundle adjustment: poses of markers and camera that minimise the reprojection errors, with covariances.

Unknown are the camera's pose in every view, the pose of every marker (on a level floor: north, east and heading)
and the shift of corners by blur towards their markers' centres, common and per view (motion and window differ; see
:mod:`.estimator.pnp`). Minimised is the sum of Cauchy's loss of the reprojection errors and of the squared
deviations from the prior of the markers. The prior also fixes the gauge: a free network has no origin, no heading,
and its scale is only the markers' printed size.

Levenberg and Marquardt's method, normal equations sparse and factorised, all derivatives analytic; steps at first
order in small rotations, applied as rotations.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray
from autopilot.core.markers import CORNER_SIGNS, IntArray
from autopilot.core.robust import PLANAR_MEDIAN
from autopilot.markermaps.markermaps_tuning import ADJUSTMENT


@dataclass(slots=True, eq=False, kw_only=True)
class Network:
    """Views, markers and observations; poses are the present estimate and change."""

    camera: CameraModel
    level: bool
    """All markers lie face up at their depth, which is known."""
    eyes_ned_m: FloatArray
    """(v, 3) projection centres of the views."""
    r_ned_from_cam: FloatArray
    """(v, 3, 3)"""
    centers_ned_m: FloatArray
    """(m, 3) of the markers."""
    r_ned_from_marker: FloatArray
    """(m, 3, 3)"""
    sizes_m: FloatArray
    """(m,)"""
    view: IntArray
    """(k,) of each observation."""
    marker: IntArray
    """(k,)"""
    corners_px: FloatArray
    """(k, 4, 2)"""
    prior_centers_ned_m: FloatArray
    """(m, 3) what is known of the markers' places,"""
    prior_r_ned_from_marker: FloatArray
    """(m, 3, 3) attitudes,"""
    prior_sigma: FloatArray
    """(m, 2) and how well: places [m], angles [rad]; infinite = not at all."""
    shrink_px: float = ADJUSTMENT.shrink_px
    view_shrink_px: FloatArray = field(init=False)
    """(v,) what each view adds."""

    def __post_init__(self) -> None:
        self.view_shrink_px = np.zeros(len(self.eyes_ned_m))

    @property
    def drawn_px(self) -> FloatArray:
        """(k, 1, 1) by how much corners of the observations are drawn inwards."""
        return (self.shrink_px + self.view_shrink_px)[self.view][:, None, None]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Adjusted:
    """Results beside the poses in the network."""

    residual_px: FloatArray
    """(k, 4, 2)"""
    weight: FloatArray
    """(k, 4) of corners, 1 = accepted."""
    sigma_px: float
    """Standard deviation of a corner along one axis, of those accepted."""
    sigma_m: FloatArray
    """(m, 3) of the markers' places, north, east, down."""
    sigma_turn_rad: FloatArray
    """(m,) of the markers' headings."""
    steps: int
    converged: bool


def adjust(network: Network) -> Adjusted:
    """Improve ``network`` in place. Deterministic."""
    sigma_px = max(ADJUSTMENT.min_sigma_px, _robust_sigma(_residuals(network)))
    damping, steps, converged = ADJUSTMENT.first_damping, 0, False
    cost, weight = _cost(network, sigma_px)
    normal, gradient = _normal_equations(network, weight, sigma_px)
    while steps < ADJUSTMENT.steps and not converged:
        steps += 1
        step = _solve(normal, gradient, damping)
        before = _poses(network)
        _apply(network, step)
        new_cost, _ = _cost(network, sigma_px)
        if not new_cost < cost:
            _restore(network, before)
            damping *= 10.0
            converged = damping > 1e8
            continue
        converged = cost - new_cost < ADJUSTMENT.converged * cost and damping <= 10.0 * ADJUSTMENT.last_damping
        # The scale of the loss follows the fit, so costs before and after that cannot be compared.
        sigma_px = max(ADJUSTMENT.min_sigma_px, _robust_sigma(_residuals(network)))
        cost, weight = _cost(network, sigma_px)
        damping = max(damping / 10.0, ADJUSTMENT.last_damping)
        normal, gradient = _normal_equations(network, weight, sigma_px)
    sigma_m, sigma_turn = _marker_sigmas(network, normal)
    return Adjusted(
        residual_px=_residuals(network),
        weight=weight,
        sigma_px=sigma_px,
        sigma_m=sigma_m,
        sigma_turn_rad=sigma_turn,
        steps=steps,
        converged=converged,
    )


def _inward(corners_px: FloatArray) -> FloatArray:
    """(k, 4, 2) unit vectors from corners towards the middle of their marker."""
    away = corners_px.mean(axis=1, keepdims=True) - corners_px
    result: FloatArray = away / np.maximum(np.linalg.norm(away, axis=2, keepdims=True), 1e-9)
    return result


def _geometry(network: Network) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of every observed corner: offset from its marker's middle in NED, offset from the eye in NED, point in the
    camera frame; all (k, 4, 3)."""
    flat = np.column_stack((0.5 * CORNER_SIGNS, np.zeros(4)))
    offsets = np.einsum("kij,cj,k->kci", network.r_ned_from_marker, flat, network.sizes_m)[network.marker]
    arms = network.centers_ned_m[network.marker][:, None] + offsets - network.eyes_ned_m[network.view][:, None]
    return offsets, arms, arms @ network.r_ned_from_cam[network.view]


def _residuals(network: Network) -> FloatArray:
    """(k, 4, 2) seen minus predicted pixels; large where a point is behind the camera."""
    _, _, points = _geometry(network)
    predicted = network.camera.project(points) + network.drawn_px * _inward(network.corners_px)
    return np.nan_to_num(network.corners_px - predicted, nan=1e4)


def _robust_sigma(residual_px: FloatArray) -> float:
    """Standard deviation along one axis from the median length of the errors."""
    return float(np.median(np.linalg.norm(residual_px, axis=2))) / PLANAR_MEDIAN


def _cost(network: Network, sigma_px: float) -> tuple[float, FloatArray]:
    """Sum to be minimised, and the weights (k, 4) that make least squares of it."""
    square = (_residuals(network) ** 2).sum(axis=2) / sigma_px**2
    limit = ADJUSTMENT.loss_sigmas**2
    loss = limit * np.log1p(square / limit)
    off, known = _prior_errors(network)
    shrink = (network.shrink_px - ADJUSTMENT.shrink_px) / ADJUSTMENT.shrink_sigma_px
    of_views = np.square(network.view_shrink_px / ADJUSTMENT.view_shrink_sigma_px).sum()
    return float(loss.sum() + (known * off**2).sum() + of_views + shrink**2), 1.0 / (1.0 + square / limit)


def _prior_errors(network: Network) -> tuple[FloatArray, FloatArray]:
    """(m, 6) deviation of markers from their prior (position, small rotation), and its information (m, 6)."""
    turn = network.r_ned_from_marker @ np.swapaxes(network.prior_r_ned_from_marker, 1, 2)
    skew = 0.5 * (turn - np.swapaxes(turn, 1, 2))
    off = np.column_stack(
        (network.centers_ned_m - network.prior_centers_ned_m, skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0])
    )
    return off, np.repeat(1.0 / network.prior_sigma**2, 3, axis=1)


def _normal_equations(network: Network, weight: FloatArray, sigma_px: float) -> tuple[Any, FloatArray]:
    """Sparse normal matrix and gradient of all unknowns: views (6 each), markers (3 or 6 each), shrink."""
    from scipy import sparse

    offsets, arms, points = _geometry(network)
    predicted, by_cam = network.camera.linearise(points)
    inward = _inward(network.corners_px)
    residual = network.corners_px - predicted - network.drawn_px * inward
    ok = np.isfinite(residual).all(axis=2) & np.isfinite(by_cam).all(axis=(2, 3))
    root = np.where(ok, np.sqrt(weight), 0.0)[..., None] / sigma_px
    residual, by_cam = np.nan_to_num(residual) * root, np.nan_to_num(by_cam) * root[..., None]
    by_point = by_cam @ np.swapaxes(network.r_ned_from_cam[network.view], 1, 2)[:, None]
    # A view that turns by t moves points, as seen from it, by -t x arm; a turning marker moves corners by t x offset.
    shrink = inward * root
    view_part = np.concatenate((-by_point, np.cross(by_point, arms[:, :, None]), shrink[..., None]), axis=3)
    marker_part = np.concatenate((by_point, np.cross(offsets[:, :, None], by_point)), axis=3)
    if network.level:
        marker_part = marker_part[..., [0, 1, 5]]
    per = marker_part.shape[3]
    views, markers = len(network.eyes_ned_m), len(network.sizes_m)
    k = len(network.view)
    rows = np.arange(8 * k).reshape(k, 4, 2, 1)
    view_columns = (ADJUSTMENT.of_view * network.view)[:, None, None, None] + np.arange(ADJUSTMENT.of_view)
    marker_columns = (ADJUSTMENT.of_view * views + per * network.marker)[:, None, None, None] + np.arange(per)
    last = ADJUSTMENT.of_view * views + per * markers
    data = np.concatenate((view_part.ravel(), marker_part.ravel(), shrink.ravel()))
    where = (
        np.concatenate((np.repeat(rows.ravel(), ADJUSTMENT.of_view), np.repeat(rows.ravel(), per), rows.ravel())),
        np.concatenate(
            (
                np.broadcast_to(view_columns, view_part.shape).ravel(),
                np.broadcast_to(marker_columns, marker_part.shape).ravel(),
                np.full(8 * k, last),
            )
        ),
    )
    jac = sparse.coo_matrix((data, where), shape=(8 * k, last + 1)).tocsr()
    off, known = _prior_errors(network)
    if network.level:
        off, known = off[:, [0, 1, 5]], known[:, [0, 1, 5]]
    of_view = np.zeros((views, ADJUSTMENT.of_view))
    of_view[:, 6] = 1.0 / ADJUSTMENT.view_shrink_sigma_px**2
    added = of_view.copy()
    added[:, 6] = network.view_shrink_px
    information = np.concatenate((of_view.ravel(), known.ravel(), [1.0 / ADJUSTMENT.shrink_sigma_px**2]))
    gradient = jac.T @ residual.ravel()
    gradient -= information * np.concatenate((added.ravel(), off.ravel(), [network.shrink_px - ADJUSTMENT.shrink_px]))
    normal = (jac.T @ jac + sparse.diags(information)).tocsc()
    return normal, gradient


def _factor(normal: Any, damping: float) -> Any:
    from scipy import sparse
    from scipy.sparse.linalg import splu

    # A view or marker that every observation has been taken from still needs a number on the diagonal.
    diagonal = normal.diagonal()
    more = damping * diagonal + 1e-12
    return splu((normal + sparse.diags(more)).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def _solve(normal: Any, gradient: FloatArray, damping: float) -> FloatArray:
    result: FloatArray = _factor(normal, damping).solve(gradient)
    return result


def _marker_sigmas(network: Network, normal: Any) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of the markers' positions (m, 3) and headings (m,), from the inverse of the normal matrix."""
    factor = _factor(normal, 0.0)
    markers = len(network.sizes_m)
    per = 3 if network.level else 6
    start, size = ADJUSTMENT.of_view * len(network.eyes_ned_m), normal.shape[0]
    wanted = np.arange(start, start + per * markers)
    variance = np.empty(len(wanted))
    for first in range(0, len(wanted), ADJUSTMENT.chunk):
        columns = wanted[first : first + ADJUSTMENT.chunk]
        unit = np.zeros((size, len(columns)))
        unit[columns, np.arange(len(columns))] = 1.0
        variance[first : first + ADJUSTMENT.chunk] = factor.solve(unit)[columns, np.arange(len(columns))]
    sigma = np.sqrt(np.maximum(variance, 0.0)).reshape(markers, per)
    if network.level:
        return np.column_stack((sigma[:, :2], np.zeros(markers))), sigma[:, 2]
    return sigma[:, :3], sigma[:, 5]


_ESTIMATED = ("eyes_ned_m", "r_ned_from_cam", "centers_ned_m", "r_ned_from_marker", "view_shrink_px", "shrink_px")


def _poses(network: Network) -> dict[str, Any]:
    """The present estimate, for :func:`_restore`."""
    return {name: getattr(network, name) for name in _ESTIMATED}


def _restore(network: Network, poses: dict[str, Any]) -> None:
    for name, value in poses.items():
        setattr(network, name, value)


def _apply(network: Network, step: FloatArray) -> None:
    """Move all poses by a step; new arrays, so that the old ones can be put back."""
    views = len(network.eyes_ned_m)
    of_view = step[: ADJUSTMENT.of_view * views].reshape(-1, ADJUSTMENT.of_view)
    network.eyes_ned_m = network.eyes_ned_m + of_view[:, :3]
    network.r_ned_from_cam = _turns(of_view[:, 3:6]) @ network.r_ned_from_cam
    network.view_shrink_px = network.view_shrink_px + of_view[:, 6]
    of_marker = step[ADJUSTMENT.of_view * views : -1].reshape(len(network.sizes_m), -1)
    move, turn = np.zeros((len(of_marker), 3)), np.zeros((len(of_marker), 3))
    if network.level:
        move[:, :2], turn[:, 2] = of_marker[:, :2], of_marker[:, 2]
    else:
        move, turn = of_marker[:, :3], of_marker[:, 3:]
    network.centers_ned_m = network.centers_ned_m + move
    network.r_ned_from_marker = _turns(turn) @ network.r_ned_from_marker
    network.shrink_px = network.shrink_px + float(step[-1])


def _turns(vectors: FloatArray) -> FloatArray:
    """(n, 3, 3) rotation matrices of rotation vectors (n, 3), by Rodrigues's formula."""
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.maximum(angle, 1e-12)[:, None]
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    s, v = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    result: FloatArray = np.eye(3) + s * cross + v * (cross @ cross)
    return result
