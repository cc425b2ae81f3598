"""The Gauss-Newton steps of :mod:`.estimator.pnp` and :mod:`.estimator.sheet_fit` in C, for Brown's lens without a port."""

import ctypes
from functools import lru_cache
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
POSE = 7
"""Unknowns without sheets: position, rotation, blur."""


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


_ADDRESSES = ("corners", "pixels", "expected", "sheet", "pivot", "print_sigma", "prior", "prior_offset")
_OUTPUTS = ("offset", "jacobian", "information", "full", "left", "weight", "keep", "work")


class _FitStruct(Mirror):
    """ctypes layout of the struct in corner_fit.c."""

    _fields_ = (
        ("markers", ctypes.c_long),
        ("sheets", ctypes.c_long),
        ("tilt", ctypes.c_double),
        ("shrink_prior", ctypes.c_double),
        ("pos", ctypes.c_double * 3),
        ("rotation", ctypes.c_double * 9),
        ("up", ctypes.c_double * 3),
        ("shrink", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in (*_ADDRESSES, *_OUTPUTS)),
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
    """(4n,) expected, and its information (4n, 4n)."""
    information: FloatArray


class Fitted(NamedTuple):
    """A fit that has converged; d = 7 + 4n unknowns."""

    pos_ned_m: FloatArray
    """(3,)"""
    rotation: FloatArray
    """(3, 3)"""
    shrink_px: float
    """Blur."""
    offset: FloatArray
    """(4n,)"""
    jacobian: FloatArray
    """(8m, d) at the last step,"""
    information: FloatArray
    """(d, d) as :class:`.estimator.pnp.CornerFit` has it in the last step: of an exact map in expected pixels and
    without priors, of sheets without the offsets' prior,"""
    full: FloatArray
    """(d, d) and with all priors."""
    left: FloatArray
    """(8m,) residuals after the last step,"""
    weight: FloatArray
    """(8m,) their inverse variances in the last step,"""
    keep: FloatArray
    """(8m,) and 0 for outliers, else 1."""


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
        self._fit, self._unbend = compiled.corner_fit, compiled.unbend

    def ideal(self, pixels: FloatArray) -> FloatArray:
        """Image points (n, 2) before the lens of pixels (n, 2)."""
        given = np.ascontiguousarray(pixels, dtype=np.float64)
        result: FloatArray = np.empty_like(given)
        self._unbend(self._at, len(given), NEWTON_STEPS, given.ctypes.data, result.ctypes.data)
        return result

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
        d = POSE + STATES * s
        sizes = (STATES * s, n * d, d * d, d * d, n, n, n, 25 * m + d + d * d)
        room = np.zeros(sum(sizes))
        places = np.cumsum((0, *sizes)).tolist()
        if on is not None:
            room[: STATES * s] = on.offset
        given: list[Any] = [np.ascontiguousarray(each, dtype=np.float64) for each in (corners_ned_m, pixels, expected_px)]
        assert given[0].size == 3 * n // 2 and given[1].size == given[2].size == n
        if on is not None:
            given.append(np.ascontiguousarray(on.sheet, dtype=np.dtype("l")))
            given += [np.ascontiguousarray(each, dtype=np.float64) for each in (on.pivot_ned_m, on.sigma_m)]
            given += [np.ascontiguousarray(each, dtype=np.float64) for each in (on.information, on.offset)]
        at = room.ctypes.data
        pos, rotation = pose
        fit = _FitStruct(
            m,
            s,
            tilt_information,
            shrink_px,
            tuple(pos.tolist()),
            tuple(rotation.ravel().tolist()),
            tuple(rotation[2].tolist()),
            shrink_px,
            *(array.ctypes.data for array in given),
            *(None,) * (len(_ADDRESSES) - len(given)),
            *(at + 8 * place for place in places[:-1]),
        )
        if not self._fit(self._at, ctypes.addressof(_TUNING), ctypes.addressof(fit)):
            return None
        offset, jacobian, information, full, left, weight, keep, _ = (
            room[begin:end] for begin, end in zip(places, places[1:], strict=False)
        )
        return Fitted(
            np.array(fit.pos[:]),
            np.array(fit.rotation[:]).reshape(3, 3),
            fit.shrink,
            offset,
            jacobian.reshape(n, d),
            information.reshape(d, d),
            full.reshape(d, d),
            left,
            weight,
            keep,
        )


@lru_cache(maxsize=8)
def compiled_fit(camera: CameraModel) -> CompiledFit | None:
    """None without the library, and for cameras that it has no model of."""
    compiled = library(_LensStruct, _FitLimits, _FitStruct)
    brown = camera.port is None and not camera.fisheye
    return CompiledFit(compiled, camera) if compiled is not None and brown else None
