"""The Gauss-Newton steps of :mod:`.pnp` and :mod:`.sheet_fit`, and the nearest markers, in C, for Brown's lens."""

import ctypes
import math
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.compiled import Mirror, address, library
from autopilot.core.frames import FloatArray
from autopilot.core.lens import NEWTON_STEPS
from autopilot.core.map_errors import STATES
from autopilot.core.markers import IntArray
from autopilot.core.robust import PLANAR_MEDIAN
from autopilot.estimator.estimator_tuning import PNP

PRINT_COUNT = 6.0
"""What the map says of its markers' print counts as so many residuals of markers."""
LEAST_PRINT = 1e-6
"""Of the print's variance over the corners': keeps shares finite."""
PRIOR_FLOOR = 1e-5
"""Of the offsets in the fit [m, rad]: keeps the inverse of their covariance finite."""
POSE = 7
"""Unknowns without sheets: position, rotation, blur."""
WIDTH = 12
"""Columns of :attr:`Fitted.rows`."""
LONG = np.dtype("l")
"""C's whole numbers."""
_NO_SHEETS: IntArray = np.zeros(1, dtype=LONG)


class _LensStruct(Mirror):
    """ctypes layout of the struct in corner_fit.c."""

    _fields_ = (
        ("focal", ctypes.c_double * 2),
        ("center", ctypes.c_double * 2),
        ("distortion", ctypes.c_double * 5),
        ("mounting", ctypes.c_double * 9),
        ("position", ctypes.c_double * 3),
        ("near_m", ctypes.c_double),
        ("focal_water", ctypes.c_double),
    )


_LIMITS = ("converged", "shrink_information", "min_scale", "prior_count", "corner_floor", "corner_ratio")


class _FitLimits(Mirror):
    """ctypes layout of the struct in corner_fit.c."""

    _fields_ = (
        ("steps", ctypes.c_long),
        *((name, ctypes.c_double) for name in (*_LIMITS, "print_count", "least_print")),
    )


class _Parts(NamedTuple):
    """Parts of the array that a fit is done in, in the order of corner_fit.c: what is given,"""

    pos: FloatArray
    rotation: FloatArray
    up: FloatArray
    numbers: FloatArray
    corners: FloatArray
    pixels: FloatArray
    expected: FloatArray
    pivot: FloatArray
    print_sigma: FloatArray
    prior_offset: FloatArray
    prior: FloatArray
    offset: FloatArray
    """what is found,"""
    rows: FloatArray
    information: FloatArray
    left: FloatArray
    keep: FloatArray
    z: FloatArray
    noise: FloatArray
    tilt_variance: FloatArray
    by_offsets: FloatArray
    alone: FloatArray
    toward: FloatArray
    strain: FloatArray
    work: FloatArray
    """and work space."""


@lru_cache(maxsize=256)
def _layout(m: int, s: int) -> tuple[int, list[tuple[slice, tuple[int, ...]]]]:
    """Length of the array for m markers on s sheets, and place and shape of each of its parts."""
    n, size = 8 * m, STATES * s
    d = POSE + size
    given = (3,), (3, 3), (3,), (4,), (4 * m, 3), (4 * m, 2), (n,), (s, 3), (m,), (size,), (size, size)
    found = (size,), (n, WIDTH), (d, d), (n,), (n,), (4,), (4, 4), (1,), (4, size), (size, size), (size,), (s,)
    shapes: list[tuple[int, ...]] = [*given, *found, (25 * m + d + 2 * d * d + size * size,)]
    ends = list(accumulate(map(math.prod, shapes), initial=0))
    return ends[-1], [(slice(*places), shape) for places, shape in zip(pairwise(ends), shapes, strict=True)]


class _MatchStruct(Mirror):
    """ctypes layout of the struct in corner_fit.c."""

    _fields_ = (
        ("markers", ctypes.c_long),
        ("most", ctypes.c_long),
        ("eye", ctypes.c_double * 3),
        ("turn", ctypes.c_double * 9),
        ("floor_m", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("pixels", "row", "candidates", "centers", "taken", "shift", "rays")),
    )


_TUNING = _FitLimits(
    PNP.steps,
    PNP.converged,
    PNP.shrink_sigma_px**-2,
    PNP.min_scale,
    PNP.prior_count,
    PNP.corner_floor,
    PNP.corner_sigmas / PLANAR_MEDIAN,
    PRINT_COUNT,
    LEAST_PRINT,
)
_TUNING_AT = ctypes.addressof(_TUNING)


class OnSheets(NamedTuple):
    """The n sheets that the m markers of a picture lie on."""

    sheet: IntArray
    """(m,) place of each marker's sheet among them, -1 = none."""
    pivot_ned_m: FloatArray
    """(n, 3)"""
    sigma_m: FloatArray
    """(m,) of each marker on its sheet."""
    offset: FloatArray
    """(4n,) expected, and its covariance (4n, 4n)."""
    covariance: FloatArray


class Fitted(NamedTuple):
    """A fit that has converged; d = 7 + 4n unknowns. From ``z`` on only with sheets, see
    :class:`.estimator.sheet_fit.SheetPose`."""

    pos_ned_m: FloatArray
    """(3,)"""
    rotation: FloatArray
    """(3, 3)"""
    rows: FloatArray
    """(8m, 12) at the last step the derivatives of the pixels by pose, blur and the offset of their own sheet,"""
    information: FloatArray
    """(d, d) and what follows from them: of an exact map in expected pixels and without priors, of sheets without the
    offsets' prior."""
    left: FloatArray
    """(8m,) residuals,"""
    keep: FloatArray
    """(8m,) and 0 for outliers, else 1."""
    offset: FloatArray
    """(4n,)"""
    z: FloatArray
    """(4,) from the pose; floors are not in the noise (4, 4)."""
    noise: FloatArray
    by_offsets: FloatArray
    alone: FloatArray
    toward: FloatArray
    strain: FloatArray
    tilt_variance: float
    shrink_px: float


class CompiledFit:
    """The library's functions for one lens."""

    def __init__(self, compiled: Any, camera: CameraModel) -> None:
        self._lens = _LensStruct(
            camera.focal_px,
            camera.center_px,
            camera.distortion,
            tuple(camera.r_frd_from_cam.ravel().tolist()),
            tuple(camera.position_frd_m.tolist()),
            camera.near_m,
            camera.focal_water_px,
        )
        self._at = ctypes.addressof(self._lens)
        self._fit, self._nearest = compiled.corner_fit, compiled.nearest_markers

    def nearest(
        self,
        pixels: FloatArray,
        row: IntArray,
        candidates: tuple[IntArray, np.ndarray],
        eye_ned_m: FloatArray,
        r_ned_from_cam: FloatArray,
        floor_m: float,
    ) -> tuple[IntArray, np.ndarray, FloatArray]:
        """The nearest marker of each row (n,) to where the corners (n, 4, 2) seem to lie on a level floor: its number
        (n,), -1 = none, the complex shift to it (n,) north + i east [m], and the ray (n, 3) of the camera frame.

        ``candidates``: numbers of the markers of each row (ids, most), -1 = no more, and their complex places."""
        n, (numbers, centers) = len(row), candidates
        given = np.ascontiguousarray(pixels, dtype=np.float64), np.ascontiguousarray(row, dtype=LONG)
        assert given[0].size == 8 * n and numbers.dtype == LONG and centers.dtype == np.complex128
        taken, shift, rays = np.empty(n, dtype=LONG), np.empty(n, dtype=np.complex128), np.empty((n, 3))
        arrays = *given, numbers, centers, taken, shift, rays
        task = _MatchStruct(
            n,
            numbers.shape[1],
            tuple(eye_ned_m.tolist()),
            tuple(r_ned_from_cam.ravel().tolist()),
            floor_m,
            *map(address, arrays),
        )
        self._nearest(self._at, NEWTON_STEPS, ctypes.addressof(task))
        return taken, shift, rays

    def converged(
        self,
        corners_ned_m: FloatArray,
        pixels: FloatArray,
        expected_px: FloatArray,
        pose: tuple[FloatArray, FloatArray],
        tilt_information: float,
        shrink_px: float,
        on: OnSheets | None = None,
    ) -> Fitted | None:
        """Fit of m markers' corners (4m, 3) seen at pixels (4m, 2) with expected deviations (8m,), from a position (3,)
        and a rotation (3, 3) whose vertical is the tilt's prior; None if it does not converge. ``on``: None = an exact
        map."""
        m = len(pixels) // 4
        s = 0 if on is None else len(on.pivot_ned_m)
        length, places = _layout(m, s)
        room = np.empty(length)
        parts = _Parts(*[room[place].reshape(shape) for place, shape in places])
        parts.pos[:], parts.rotation[:] = pose
        parts.up[:] = parts.rotation[2]
        parts.numbers[:] = tilt_information, shrink_px, shrink_px, PRIOR_FLOOR
        parts.corners[:], parts.pixels[:], parts.expected[:] = corners_ned_m.reshape(-1, 3), pixels, expected_px
        sheet = _NO_SHEETS
        if on is not None:
            sheet = np.ascontiguousarray(on.sheet, dtype=LONG)
            if sheet.shape != (m,) or not -1 <= sheet.min() <= sheet.max() < s:
                raise ValueError(f"sheets {sheet} of {m} markers on {s}")
            parts.pivot[:], parts.print_sigma[:] = on.pivot_ned_m, on.sigma_m
            parts.prior_offset[:], parts.prior[:] = on.offset, on.covariance
        found = self._fit(self._at, _TUNING_AT, m, s, address(sheet), address(room))
        if not found:
            return None
        return Fitted(
            parts.pos,
            parts.rotation,
            parts.rows,
            parts.information,
            parts.left,
            parts.keep,
            parts.offset,
            parts.z,
            parts.noise,
            parts.by_offsets,
            parts.alone,
            parts.toward,
            parts.strain,
            parts.tilt_variance.item(),
            parts.numbers.item(2),
        )


@lru_cache(maxsize=8)
def compiled_fit(camera: CameraModel) -> CompiledFit | None:
    """None without the library, and for cameras that it has no model of."""
    compiled = library(_LensStruct, _FitLimits, _MatchStruct)
    brown = camera.port is None and not camera.fisheye
    return CompiledFit(compiled, camera) if compiled is not None and brown else None
