"""The Gauss-Newton steps of :mod:`.estimator.pnp` and :mod:`.estimator.sheet_fit` in C, for Brown's lens without a port."""

import ctypes
import math
from functools import lru_cache
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.compiled import Mirror, library
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
SHEET = 3
"""Which of the inputs holds whole numbers."""
_LONG = np.dtype("l")


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


_INPUTS = ("corners", "pixels", "expected", "sheet", "pivot", "print_sigma", "prior", "prior_offset")
_OUTPUTS = ("offset", "rows", "information", "left", "keep", "by_offsets", "alone", "toward", "strain", "work")


class _FitStruct(Mirror):
    """ctypes layout of the struct in corner_fit.c."""

    _fields_ = (
        ("markers", ctypes.c_long),
        ("sheets", ctypes.c_long),
        ("tilt", ctypes.c_double),
        ("shrink_prior", ctypes.c_double),
        ("offset_floor", ctypes.c_double),
        ("pos", ctypes.c_double * 3),
        ("rotation", ctypes.c_double * 9),
        ("up", ctypes.c_double * 3),
        ("shrink", ctypes.c_double),
        ("z", ctypes.c_double * 4),
        ("noise", ctypes.c_double * 16),
        ("tilt_variance", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in (*_INPUTS, *_OUTPUTS)),
    )


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
        given = np.ascontiguousarray(pixels, dtype=np.float64), np.ascontiguousarray(row, dtype=_LONG)
        assert given[0].size == 8 * n and numbers.dtype == _LONG and centers.dtype == np.complex128
        taken, shift, rays = np.empty(n, dtype=_LONG), np.empty(n, dtype=np.complex128), np.empty((n, 3))
        arrays = *given, numbers, centers, taken, shift, rays
        task = _MatchStruct(
            n,
            numbers.shape[1],
            tuple(eye_ned_m.tolist()),
            tuple(r_ned_from_cam.ravel().tolist()),
            floor_m,
            *(array.ctypes.data for array in arrays),
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
        n, s = 8 * m, 0 if on is None else len(on.pivot_ned_m)
        size = STATES * s
        d = POSE + size
        shapes = (size,), (n, 12), (d, d), (n,), (n,), (4, size), (size, size), (size,), (s,), (25 * m + d + 3 * d * d,)
        ends = list(accumulate(map(math.prod, shapes), initial=0))
        room = np.empty(ends[-1])
        given: list[Any] = [corners_ned_m, pixels, expected_px]
        if on is not None:
            given += [on.sheet, on.pivot_ned_m, on.sigma_m, on.covariance, on.offset]
        given = [np.ascontiguousarray(each, _LONG if k == SHEET else np.float64) for k, each in enumerate(given)]
        sizes = [12 * m, n, n, m, 3 * s, m, size * size, size]
        if [array.size for array in given] != sizes[: len(given)]:
            raise ValueError(f"arrays of {[array.size for array in given]} for {m} markers on {s} sheets")
        at = room.ctypes.data
        pos, rotation = pose
        fit = _FitStruct(
            m,
            s,
            tilt_information,
            shrink_px,
            PRIOR_FLOOR,
            tuple(pos.tolist()),
            tuple(rotation.ravel().tolist()),
            tuple(rotation[2].tolist()),
            shrink_px,
            (),
            (),
            0.0,
            *(array.ctypes.data for array in given),
            *(None,) * (len(_INPUTS) - len(given)),
            *(at + 8 * end for end in ends[:-1]),
        )
        if not self._fit(self._at, ctypes.addressof(_TUNING), ctypes.addressof(fit)):
            return None
        offset, rows, information, left, keep, *sheets = (
            room[begin:end].reshape(shape) for begin, end, shape in zip(ends, ends[1:], shapes, strict=False)
        )
        pos, rotation, z, noise = (np.array(each[:]) for each in (fit.pos, fit.rotation, fit.z, fit.noise))
        rotation, noise = rotation.reshape(3, 3), noise.reshape(4, 4)
        by_offsets, alone, toward, strain, _ = sheets
        return Fitted(
            pos,
            rotation,
            rows,
            information,
            left,
            keep,
            offset,
            z,
            noise,
            by_offsets,
            alone,
            toward,
            strain,
            fit.tilt_variance,
        )


@lru_cache(maxsize=8)
def compiled_fit(camera: CameraModel) -> CompiledFit | None:
    """None without the library, and for cameras that it has no model of."""
    compiled = library(_LensStruct, _FitLimits, _FitStruct, _MatchStruct)
    brown = camera.port is None and not camera.fisheye
    return CompiledFit(compiled, camera) if compiled is not None and brown else None
