"""Control allocation: thrust for a wanted generalised force, and the attainable set of a vehicle's thrusters.

T_A (4, n) maps thrust to force; this is its inverse. With as many thrusters as axes the solution is unique. Redundant
thrusters are allocated by weighted least squares, min sum c_i F_i^2 with c_i the power coefficient of thruster i, as
the NMPC's weights on thrust do (Fossen 2011, section 12.3). Bounds are hard: an unattainable force is approximated by
min (T_A F - f)^T S (T_A F - f) with S = (T_A C^-1 T_A^T)^-1, the weighted norm of the thrust that would be missing.
For a square T_A that is the unconstrained solution, each thruster clipped at its bound.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.model4 import AXES, AXIS_NAMES, Model4, steady_force
from autopilot.core.thrusters import Thruster

EXACT = 1e6
"""Weight of a missing force relative to the thrust that would produce it."""

MADE = 1e-3
"""A force is made when so small a share of it is missing."""

SINGULAR = 1e-6
"""Relative difference below which axes are treated as one."""

SLOWEST = (0.05, 0.05, 0.02, 0.1)
"""Ahead, sideways, down [m/s] and turning [rad/s]: thrust that cannot keep up so little is none."""

MOST_CHANGES = 100

HALVINGS = 12
"""The reach is known to a two-thousandth."""


def least_in_box(h: FloatArray, g: FloatArray, bound: FloatArray) -> FloatArray:
    """x (n,) that minimises x^T h x / 2 + g^T x within +-``bound`` (n,); ``h`` (n, n) positive definite.

    Projected Newton (Bertsekas 1982): ends after a few changes of the active set.
    """

    def value(x: FloatArray) -> float:
        return float(x @ (0.5 * (h @ x) + g))

    scale = np.abs(g).max() + np.abs(h).max() * np.abs(bound).max() + 1e-300
    x: FloatArray = np.zeros(len(g))
    for _ in range(MOST_CHANGES):
        slope = h @ x + g
        free = ~(((x <= -bound) & (slope >= 0.0)) | ((x >= bound) & (slope <= 0.0)))
        if not free.any() or float(np.abs(slope[free]).max()) < 1e-13 * scale:
            break
        step = np.zeros_like(x)
        step[free] = np.linalg.solve(h[np.ix_(free, free)], -slope[free])
        fraction, now, gain = 1.0, value(x), float(slope @ step)
        after = np.clip(x + step, -bound, bound)
        while value(after) > now + 0.1 * float(slope @ (after - x)) and fraction > 1e-9:
            fraction *= 0.5
            after = np.clip(x + fraction * step, -bound, bound)
        done = fraction > 0.99 and bool((np.abs(x + step) <= bound)[free].all()) and -gain < 1e-12 * (abs(now) + 1e-300)
        x = after
        if done:
            break
    return x


class ThrusterBearing(Protocol):
    """The required part of a vehicle file."""

    @property
    def thrusters(self) -> tuple[Thruster, ...]: ...

    def to_model(self) -> Model4:
        """The 4-DoF model."""
        ...


class ControlAllocator:
    """Control allocation of one vehicle. ``watts`` (n,): power coefficient of each thruster, relative to the others."""

    def __init__(self, model: Model4, watts: Sequence[float] | None = None) -> None:
        self._model = model
        self.buoyancy_excess_n = model.buoyancy_excess_n
        """Buoyancy minus weight [N] in use; set to the estimated one."""
        self._allocation = np.array(model.allocation)
        self._watts = np.ones(model.thrusters) if watts is None else np.array(watts, dtype=float)
        self._all = np.ones(model.thrusters, dtype=bool)
        self._inverse: dict[bytes, FloatArray | None] = {}
        self._metric = _metric(self._allocation, self._watts)
        self._plain = self._of(self._all)
        self.square = model.thrusters == AXES and self._plain is not None
        """As many thrusters as axes: excess is clipped, as there is no redundancy."""
        self._impossible = np.full((AXES, model.thrusters), np.nan)

    @classmethod
    def of(cls, vehicle: "ThrusterBearing") -> "ControlAllocator":
        drives = [thruster.drive for thruster in vehicle.thrusters]
        both = [0.5 * (drive.power_w_n15 + (drive.reverse_power_w_n15 or drive.power_w_n15)) for drive in drives]
        return cls(vehicle.to_model(), both)

    @property
    def model(self) -> Model4:
        """The 4-DoF model with that buoyancy."""
        if self._model.buoyancy_excess_n != self.buoyancy_excess_n:
            self._model = replace(self._model, buoyancy_excess_n=self.buoyancy_excess_n)
        return self._model

    def thrust_n(self, force: FloatArray, limit_n: FloatArray) -> FloatArray:
        """(..., n) thrust within +-``limit_n`` (n,) (inf = as it comes) for forces (..., 4) X, Y, Z [N], N [N m]."""
        if self.square and self._plain is not None:
            return np.clip(force @ self._plain, -limit_n, limit_n)
        inverse = self._of(limit_n > 0.0)
        rows = np.atleast_2d(force)
        thrust = np.zeros((len(rows), len(limit_n))) if inverse is None else rows @ inverse
        beyond = (np.abs(thrust) > limit_n).any(axis=1) if inverse is not None else np.ones(len(rows), dtype=bool)
        for i in np.flatnonzero(beyond):
            thrust[i] = self._nearest(rows[i], limit_n)
        return thrust.reshape(*force.shape[:-1], len(limit_n))

    def linear(self, limit_n: FloatArray) -> FloatArray:
        """(4, n) contiguous: forces times that is the thrust of thrusters whose limits (n,) are not reached; not
        finite where those that are left do not make every force."""
        inverse = self._plain if self.square else self._of(limit_n > 0.0)
        return self._impossible if inverse is None else inverse

    def hold_n(self, nu: FloatArray, limit_n: FloatArray) -> FloatArray:
        """(m, n) thrust for velocities (m, 4) u, v, w, r: drag, buoyancy and Munk moment against T_A F. Within
        ``limit_n`` (n,); unattainable forces are approximated.
        """
        force = np.empty_like(nu)
        force.T[:] = steady_force(self.model, (nu[:, 0], nu[:, 1], nu[:, 2], nu[:, 3]), np)
        return self.thrust_n(force, limit_n)

    def makes(self, force: FloatArray, limit_n: FloatArray) -> bool:
        """Whether thrusters that give up to ``limit_n`` (n,) make that force (4,)."""
        missing = self._allocation @ self._nearest(force, limit_n) - force
        return float(np.abs(missing).max()) <= MADE * float(np.abs(force).max()) + 1e-9

    def reach(self, limit_n: FloatArray) -> FloatArray:
        """(4,) the largest force of each axis [N], and moment [N m], that comes with no other."""
        most = np.abs(self._allocation) @ limit_n
        reach = np.zeros(AXES)
        for axis in range(AXES):
            low, high = 0.0, float(most[axis])
            for _ in range(HALVINGS if high > 0.0 else 0):
                middle = 0.5 * (low + high)
                force = np.zeros(AXES)
                force[axis] = middle
                low, high = (middle, high) if self.makes(force, limit_n) else (low, middle)
            reach[axis] = low
        return reach

    def _of(self, alive: NDArray[np.bool_]) -> FloatArray | None:
        """(4, n) transposed inverse with the thrusters that are alive, None where they do not span all axes."""
        key = alive.tobytes()
        if key not in self._inverse:
            self._inverse[key] = _inverse(self._allocation, self._watts, alive)
        return self._inverse[key]

    def _nearest(self, force: FloatArray, limit_n: FloatArray) -> FloatArray:
        pull = EXACT * self._allocation.T @ self._metric
        return least_in_box(np.diag(self._watts) + pull @ self._allocation, -pull @ force, limit_n)


def _inverse(allocation: FloatArray, watts: FloatArray, alive: NDArray[np.bool_]) -> FloatArray | None:
    kept = allocation[:, alive]
    if kept.shape[1] < AXES or uncontrolled_axes(kept):
        return None
    if kept.shape[1] == AXES and bool(alive.all()):
        return np.array(np.linalg.inv(allocation).T, order="C", dtype=np.float64)
    light = kept / np.sqrt(watts[alive])
    inverse = np.zeros_like(allocation)
    inverse[:, alive] = np.linalg.pinv(light).T / np.sqrt(watts[alive])
    return inverse


def _metric(allocation: FloatArray, watts: FloatArray) -> FloatArray:
    """(4, 4) S; an axis without thrusters counts for nothing."""
    cost = np.linalg.pinv((allocation / watts) @ allocation.T, rcond=SINGULAR**2, hermitian=True)
    return np.asarray(cost, dtype=np.float64)


def uncontrolled_axes(allocation: FloatArray) -> tuple[int, ...]:
    """Axes of T_A (4, n) that no thrust pushes without pushing another as well, the most dependent one first."""
    size = np.abs(allocation).max(axis=1)
    left, stretch, _ = np.linalg.svd(allocation / np.where(size > 0.0, size, 1.0)[:, None])
    stretch = np.append(stretch, np.zeros(AXES - len(stretch)))
    part = np.abs(left[:, stretch <= SINGULAR * stretch[0]]).max(axis=1, initial=0.0)
    uncontrolled = [axis for axis in range(AXES) if part[axis] > 1e-3]
    return tuple(sorted(uncontrolled, key=lambda axis: (-round(float(part[axis]), 6), -axis)))


def lacking_thrust(model: Model4, limit_n: FloatArray) -> str:
    """Which axis the thrusters, giving up to ``limit_n`` (n,), leave without thrust, in a sentence; "" if none.

    Surge, sway, heave and yaw are controlled, each by itself: a place is held at any heading.
    """
    allocation = np.array(model.allocation)
    none = [AXIS_NAMES[i] for i in range(AXES) if not (np.abs(allocation[i]) @ limit_n > 0.0)]
    if none:
        return f"no thrust in {' and '.join(none)}: no thruster pushes that way; add one"
    axis, *others = [AXIS_NAMES[i] for i in uncontrolled_axes(allocation)] or ("",)
    if axis:
        return f"no thrust in {axis} alone: it comes only with {' and '.join(others)}; turn a thruster or add one"
    reach = ControlAllocator(model).reach(limit_n)
    for i, (name, unit) in enumerate(zip(AXIS_NAMES, ("N", "N", "N", "N m"), strict=True)):
        velocity = [SLOWEST[j] if j == i else 0.0 for j in range(AXES)]
        needs = abs(float(steady_force(model, velocity, math)[i]))
        if i == 2:
            needs += 2.0 * abs(model.buoyancy_excess_n)
        if reach[i] < needs:
            return f"too little thrust in {name}: {reach[i]:.2f} {unit} alone, needs {needs:.2f}"
    return ""
