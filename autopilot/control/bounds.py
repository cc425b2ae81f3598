"""Bounds of one NMPC problem after tightening, and the thrust that holds the plan."""

import ctypes

import numpy as np

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.path.guidance import GuidanceInputs, Reference
from autopilot.control.robust.robust_tuning import TUBE
from autopilot.control.robust.tightening import BackOffs
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
    """ctypes layout of the struct in program.c."""

    _fields_ = (
        ("n", ctypes.c_long),
        ("thrusters", ctypes.c_long),
        *((name, ctypes.c_double) for name in (*_NUMBERS, "slowest_m_s", "largest_thrust_share", "change")),
        *((name, ctypes.c_void_p) for name in (*_GIVEN, *_MADE)),
    )


class ProgramBounds:
    """Bounds of one optimiser, as arrays that :meth:`fill` writes."""

    def __init__(self, grid: TimeGrid, thrusters: int, radius_m: float) -> None:
        n, each = grid.n, (grid.n, thrusters)
        self.limits: FloatArray = np.zeros((n - 1, ocp.N_LIMITS))
        self.thrust_n: FloatArray = np.zeros(each)
        """(N, n) thrust limits after back-offs [N]."""
        self.keep_m: FloatArray = np.zeros(n - 1)
        """(N-1,) distance of the centre from boundaries."""
        self.tube_m: FloatArray = np.zeros(n + 1)
        """(N+1,) the same beyond the body, of every node."""
        self.held_ref_n: FloatArray = np.zeros(each)
        """(N, n) thrust between what is wished for and that of the last plan, ..."""
        self._held_weight: FloatArray = np.zeros(each)
        self.held_weight = self._held_weight
        """(n,) or (N, n), as the wish's, ... with the weight of both."""
        made = (self.limits, self.thrust_n, self.keep_m, self.tube_m, self.held_ref_n, self._held_weight)
        self._given = tuple(np.zeros(shape) for shape in ((_KINDS, n - 1), each, (thrusters,), each, each, each))
        self._struct = _Program(
            n=n,
            thrusters=thrusters,
            radius_m=radius_m,
            slowest_m_s=SLOWEST_CAP_M_S,
            largest_thrust_share=TUBE.largest_thrust_fraction,
            **{name: array.ctypes.data for name, array in zip((*_GIVEN, *_MADE), (*self._given, *made), strict=True)},
        )
        self._reference, self._call = ctypes.byref(self._struct), compiled.load(_Program).program_bounds

    def fill(
        self, back_off: BackOffs, now: GuidanceInputs, reference: Reference, plan_n: FloatArray, change: float
    ) -> None:
        """``plan_n`` (N, n): thrust of the last plan [N]; ``change``: weight on the deviation from it."""
        params, fence, struct = now.params, now.fence, self._struct
        struct.planar_m_s, struct.heave_m_s = params["SPD_PLANAR_MAX"], params["SPD_HEAVE_MAX"]
        struct.yaw_rate_rad_s, struct.depth_m, struct.change = params["SPD_YAW_MAX"], float(now.x0[Z]), change
        struct.depth_min_m = max(fence.depth_min_m, params["DEPTH_MIN"])
        struct.depth_max_m = min(fence.depth_max_m, params["DEPTH_MAX"])
        states, thrust_back_off, limit_n, thrust_ref, thrust, weight = self._given
        states[0], states[1], states[2] = back_off.clearance_m, back_off.depth_m, back_off.planar_speed_m_s
        states[3], states[4] = back_off.heave_m_s, back_off.yaw_rate_rad_s
        thrust_back_off[:], limit_n[:], thrust_ref[:] = back_off.thrust_n, now.thrust_limit_n, reference.thrust_n
        thrust[:], weight[:] = plan_n, reference.weight_u
        self._call(self._reference)
        self.held_weight = self._held_weight if reference.weight_u.ndim > 1 else self._held_weight[0]


def left_n(limit_n: FloatArray, back_off_n: FloatArray) -> FloatArray:
    """Thrust limits (n,) [N] minus the back-offs."""
    return limit_n - np.minimum(back_off_n, TUBE.largest_thrust_fraction * limit_n)


class PlanClearance:
    """Distances of a plan from its half-planes."""

    def __init__(self, path: FloatArray, plane_n: FloatArray, plane_d_m: FloatArray) -> None:
        """Points (m, 2), rows of a table; normals (m, slots, 2), offsets (m, slots), contiguous. ValueError if they are
        not so many."""
        m, slots = plane_d_m.shape
        if path.shape != (m, 2):
            raise ValueError(f"path {path.shape} does not fit to plane_d_m {plane_d_m.shape}")
        planes = compiled.fitting("plane_n", plane_n, m, slots, 2), compiled.fitting("plane_d_m", plane_d_m, m, slots)
        self._arrays, self._call = (path, plane_n, plane_d_m), compiled.load().least_room
        self._arguments = (m, slots, path.ctypes.data, path.strides[0] // path.itemsize, *planes)

    def least_m(self) -> float:
        """Smallest distance to a half-plane [m]; inf without half-planes."""
        least: float = self._call(*self._arguments)
        return least


def largest_gap(a: FloatArray, b: FloatArray | None, first: int, width: int) -> float:
    """Largest difference of ``width`` columns from ``first`` on of contiguous tables (m, columns); b None = of a from
    zero. NaN if there is one. ValueError if they have other shapes or too few columns."""
    if first + width > a.shape[1]:
        raise ValueError(f"columns {first} to {first + width} of {a.shape[1]}")
    other = None if b is None else compiled.fitting("b", b, *a.shape)
    gap: float = compiled.load().largest_gap(*a.shape, first, width, compiled.fitting("a", a, *a.shape), other)
    return gap
