"""Limits and bounds of one program, from what margins leave of the vehicle's; and the wishes that hold the last plan.

By the compiled library (``data/native/program.c``) where there is one.
"""

import ctypes
import math

import numpy as np

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.robust.robust_tuning import TUBE
from autopilot.control.robust.tightening import BackOffs
from autopilot.control.way.guidance import GuidanceInputs, Reference
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import Z

SLOWEST_CAP_M_S = 0.05
"""Margins do not lower the cap of the planar speed below this."""

_KINDS = 5
_NUMBERS = ("radius_m", "planar_m_s", "heave_m_s", "yaw_rate_rad_s", "depth_min_m", "depth_max_m", "depth_m")
_GIVEN = ("back_off", "thrust_back_off", "limit_n", "thrust_ref", "thrust", "weight")
_MADE = ("limits", "left", "keep_m", "tube_m", "held", "held_weight")


class _Program(compiled.Mirror):
    """The struct of program.c."""

    _fields_ = (
        ("n", ctypes.c_long),
        ("thrusters", ctypes.c_long),
        *((name, ctypes.c_double) for name in (*_NUMBERS, "slowest_m_s", "largest_thrust_share", "change")),
        *((name, ctypes.c_void_p) for name in (*_GIVEN, *_MADE)),
    )


class ProgramBounds:
    """The arrays of one optimiser; :meth:`fill` writes all of them."""

    def __init__(self, grid: TimeGrid, thrusters: int, radius_m: float) -> None:
        n, self._radius_m = grid.n, radius_m
        self.limits: FloatArray = np.zeros((n - 1, ocp.N_LIMITS))
        self.thrust_n: FloatArray = np.zeros((n, thrusters))
        """(N, n) what margins leave of the thrust limits."""
        self.keep_m: FloatArray = np.zeros(n - 1)
        """(N-1,) distance of the centre from boundaries."""
        self.tube_m: FloatArray = np.zeros(n + 1)
        """(N+1,) the same beyond the body, of every node."""
        self.held_ref_n: FloatArray = np.zeros((n, thrusters))
        """(N, n) thrust between what is wished for and that of the last plan, ..."""
        self.held_weight: FloatArray = np.zeros(thrusters)
        """(n,) or (N, n), as the wish's, ... with the weight of both."""
        self._one_weight, self._each_weight = self.held_weight, np.zeros((n, thrusters))
        """Where it is kept for wishes that weigh the same at all nodes, or not: the library writes to the first."""
        library = compiled.library(_Program)
        self._call = None if library is None else library.program_bounds
        made = (self.limits, self.thrust_n, self.keep_m, self.tube_m, self.held_ref_n, self._one_weight)
        shapes = (_KINDS, n - 1), (n, thrusters), (thrusters,), (n, thrusters), (n, thrusters), (thrusters,)
        self._given = tuple(np.zeros(shape) for shape in shapes)
        self._told = _Program(
            n=n,
            thrusters=thrusters,
            radius_m=radius_m,
            slowest_m_s=SLOWEST_CAP_M_S,
            largest_thrust_share=TUBE.largest_thrust_share,
            **{name: array.ctypes.data for name, array in zip((*_GIVEN, *_MADE), (*self._given, *made), strict=True)},
        )
        self._reference = ctypes.byref(self._told)

    def fill(
        self, back_off: BackOffs, now: GuidanceInputs, reference: Reference, plan_n: FloatArray, change: float
    ) -> None:
        """``plan_n`` (N, n): thrust of the last plan; ``change``: weight on what is changed of it."""
        params, fence, told, depth_m = now.params, now.fence, self._told, float(now.x0[Z])
        planar, heave, turn = params["SPD_PLANAR_MAX"], params["SPD_HEAVE_MAX"], params["SPD_YAW_MAX"]
        top, bottom = max(fence.depth_min_m, params["DEPTH_MIN"]), min(fence.depth_max_m, params["DEPTH_MAX"])
        if self._call is None or reference.weight_u.ndim > 1:
            self._fill_limits(back_off, (planar, heave, turn), (top, bottom), depth_m)
            self._hold(back_off, now.thrust_limit_n, reference, plan_n, change)
            return
        told.planar_m_s, told.heave_m_s, told.yaw_rate_rad_s = planar, heave, turn
        told.depth_min_m, told.depth_max_m, told.depth_m, told.change = top, bottom, depth_m, change
        states, thrust_back_off, limit_n, thrust_ref, thrust, weight = self._given
        states[0], states[1], states[2] = back_off.clearance_m, back_off.depth_m, back_off.planar_speed_m_s
        states[3], states[4] = back_off.heave_m_s, back_off.yaw_rate_rad_s
        thrust_back_off[:], limit_n[:], thrust_ref[:] = back_off.thrust_n, now.thrust_limit_n, reference.thrust_n
        thrust[:], weight[:] = plan_n, reference.weight_u
        self.held_weight = self._one_weight
        self._call(self._reference)

    def _fill_limits(
        self, back_off: BackOffs, speeds: tuple[float, float, float], band_m: tuple[float, float], depth_m: float
    ) -> None:
        limits = self.limits
        limits[:, 0] = np.maximum(speeds[0] - back_off.planar_speed_m_s, SLOWEST_CAP_M_S)
        limits[:, 1] = np.maximum(speeds[1] - back_off.heave_m_s, 0.0)
        limits[:, 2] = np.maximum(speeds[2] - back_off.yaw_rate_rad_s, 0.0)
        # A vehicle outside its band is asked to come no farther out, not to be inside at once.
        limits[:, 3] = np.minimum(depth_m, band_m[0] + back_off.depth_m)
        limits[:, 4] = np.maximum(depth_m, band_m[1] - back_off.depth_m)
        self.keep_m[:] = self._radius_m + back_off.clearance_m
        self.tube_m[1:-1] = back_off.clearance_m
        self.tube_m[0], self.tube_m[-1] = back_off.clearance_m[0], back_off.clearance_m[-1]

    def _hold(
        self, back_off: BackOffs, limit_n: FloatArray, reference: Reference, plan_n: FloatArray, change: float
    ) -> None:
        self.thrust_n[:] = left = left_n(limit_n, back_off.thrust_n)
        wanted = np.minimum(np.maximum(reference.thrust_n, -left), left)
        self.held_weight = self._each_weight if reference.weight_u.ndim > 1 else self._one_weight
        self.held_weight[:] = reference.weight_u + change
        self.held_ref_n[:] = (reference.weight_u * wanted + change * plan_n) / self.held_weight


def left_n(limit_n: FloatArray, back_off_n: FloatArray) -> FloatArray:
    """What the margins leave of thrust limits (n,)."""
    left: FloatArray = limit_n - np.minimum(back_off_n, TUBE.largest_thrust_share * limit_n)
    return left


class PlanRoom:
    """By how much a plan meets its half-planes; of one set of arrays."""

    def __init__(self, path: FloatArray, plane_n: FloatArray, plane_d_m: FloatArray) -> None:
        """Points (m, 2), normals (m, slots, 2), offsets (m, slots). ValueError if they are not so many."""
        self._path, self._plane_n, self._plane_d_m = path, plane_n, plane_d_m
        if path.shape != (len(plane_d_m), 2) or plane_n.shape != (*plane_d_m.shape, 2):
            raise ValueError(f"path {path.shape}, plane_n {plane_n.shape} do not fit to plane_d_m {plane_d_m.shape}")
        library, contiguous = compiled.library(), plane_n.flags.c_contiguous and plane_d_m.flags.c_contiguous
        tight = path.strides[1] == path.itemsize and contiguous
        self._call = None if library is None or not tight else library.least_room
        stride = path.strides[0] // path.itemsize
        self._told = (*plane_d_m.shape, path.ctypes.data, stride, plane_n.ctypes.data, plane_d_m.ctypes.data)

    def least_m(self) -> float:
        """The smallest distance beyond what a half-plane asks for; inf where there is none."""
        if self._call is not None:
            least: float = self._call(*self._told)
            return least
        n, path = self._plane_n, self._path
        room = n[..., 0] * path[:, :1] + n[..., 1] * path[:, 1:] - self._plane_d_m
        return float(room.min(initial=math.inf))


class Gaps:
    """Largest differences between tables of states."""

    def __init__(self) -> None:
        library = compiled.library()
        self._call = None if library is None else library.largest_gap

    def largest(self, a: FloatArray, b: FloatArray | None, first: int, width: int) -> float:
        """Of ``width`` columns from ``first`` on of contiguous tables (m, 8); None = from zero. NaN if there is one.
        ValueError if they have other shapes or too few columns."""
        if self._call is not None:
            if first + width > a.shape[1]:
                raise ValueError(f"columns {first} to {first + width} of {a.shape[1]}")
            other = None if b is None else compiled.fitting("b", b, *a.shape)
            gap: float = self._call(*a.shape, first, width, compiled.fitting("a", a, *a.shape), other)
            return gap
        columns = slice(first, first + width)
        return float(np.abs(a[:, columns] if b is None else a[:, columns] - b[:, columns]).max())
