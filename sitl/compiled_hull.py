"""One step of the hull by the compiled library (``data/native/plant.c``): bit-identical to :mod:`.sitl.rigid_body` and
:mod:`autopilot.sitl.thruster_models`, which document the quantities, in a tenth of the time.

Hulls that may be in contact are left to the Python code.
"""

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np

from autopilot.core.compiled import Mirror
from autopilot.core.frames import FloatArray
from autopilot.core.messages import MAX_THRUSTERS
from autopilot.core.thrusters import Thruster
from autopilot.core.vehicle import Body
from autopilot.sitl.rigid_body import Water, Wrench, displaced_mass_kg
from autopilot.sitl.tether import TetherForce

_Eight = ctypes.c_double * MAX_THRUSTERS
_Three, _State, _Columns = ctypes.c_double * 3, ctypes.c_double * 13, (ctypes.c_double * 6) * MAX_THRUSTERS


WATER = 13
"""Numbers of the water, from ``current`` on to ``rate``."""


class HullStruct(Mirror):
    """ctypes layout of the struct in plant.c."""

    _fields_ = (
        ("mass", ctypes.c_double),
        *((name, _Three) for name in ("added", "inertia", "linear", "quadratic", "turn_linear", "turn_quadratic")),
        *((name, ctypes.c_double) for name in ("weight", "buoyancy", "displaced")),
        ("center", _Three),
        ("half_height", ctypes.c_double),
        ("tethered", ctypes.c_double),
        ("entry", _Three),
        *((name, ctypes.c_double) for name in ("tether_drag", "tether_pull", "slack")),
        ("columns", _Columns),
        *((name, _Eight) for name in ("tau", "ahead_power", "astern_power")),
        ("thrusters", ctypes.c_double),
    )


class Hull(Mirror):
    """ctypes layout of the struct in plant.c."""

    _fields_ = (
        *((name, _State) for name in ("state", "change")),
        *((name, _Eight) for name in ("motor", "gain", "goal", "mean")),
        ("power", ctypes.c_double),
        ("external", ctypes.c_double * 9),
        ("current", _Three),
        ("place", ctypes.c_double * 2),
        ("varies", ctypes.c_double),
        ("gradient", ctypes.c_double * 4),
        ("rate", _Three),
        *((name, ctypes.c_double) for name in ("held", "gravity")),
        ("numbers", ctypes.c_double * (25 + MAX_THRUSTERS)),
    )


STRUCTS = HullStruct, Hull


class CompiledHull:
    """State, coefficients and thrusters of one hull where the library has them."""

    def __init__(
        self,
        library: Any,
        body: Body,
        thrusters: Sequence[Thruster],
        columns: Sequence[Sequence[float]],
        tether: TetherForce | None,
        *,
        hull_half_height_m: float,
        froude_krylov: bool,
        gravity_m_s2: float,
    ) -> None:
        """``columns``: force and moment (6,) of 1 N of each thruster."""
        drives = [thruster.drive for thruster in thrusters]
        astern = [d.power_w_n15 if d.reverse_power_w_n15 is None else d.reverse_power_w_n15 for d in drives]
        inertia = [rigid + added for rigid, added in zip(body.inertia_kg_m2, body.added_inertia_kg_m2, strict=True)]
        coefficients = HullStruct(
            mass=body.mass_kg,
            added=_Three(*body.added_mass_kg),
            inertia=_Three(*inertia),
            linear=_Three(*body.linear_drag_n_s_m),
            quadratic=_Three(*body.quadratic_drag_n_s2_m2),
            turn_linear=_Three(*body.angular_linear_drag_n_m_s),
            turn_quadratic=_Three(*body.angular_quadratic_drag_n_m_s2),
            weight=body.weight_n,
            buoyancy=body.weight_n + body.buoyancy_excess_n,
            displaced=displaced_mass_kg(body) if froude_krylov else 0.0,
            center=_Three(*body.center_of_buoyancy_frd_m),
            half_height=hull_half_height_m,
            columns=_Columns(*((ctypes.c_double * 6)(*column) for column in columns)),
            tau=_Eight(*(drive.time_constant_s for drive in drives)),
            ahead_power=_Eight(*(drive.power_w_n15 for drive in drives)),
            astern_power=_Eight(*astern),
            thrusters=len(drives),
        )
        if tether is not None:
            coefficients.tethered, coefficients.entry = 1.0, _Three(*tether.entry_ned_m)
            coefficients.tether_drag, coefficients.tether_pull = tether.drag_n_s2_m2, tether.pull_n
            coefficients.slack = tether.slack_m
        self._own = coefficients, Hull(gravity=gravity_m_s2)
        self._hull = hull = self._own[1]
        self._state, self._external = hull.state, hull.external
        self._water: Any = (ctypes.c_double * WATER).from_buffer(hull, Hull.current.offset)
        self._numbers = np.frombuffer(hull.numbers)
        self._both = ctypes.byref(coefficients), ctypes.byref(hull)
        self._evaluate, self._turn = library.plant_look, library.plant_turn
        self._step, self._measure = library.plant_step, library.plant_measure
        self.motor_n, self.gain, self.goal_n, self.mean_n = hull.motor, hull.gain, hull.goal, hull.mean
        """Per thruster, unused ones 0; read and written."""

    @property
    def power_w(self) -> float:
        """Electrical power of the thrusters [W]."""
        power: float = self._hull.power
        return power

    def evaluate(self, state: Sequence[float], water: Water, external: Wrench) -> None:
        """The hull is here, the water like this, and nothing is touched."""
        (cn, ce, cd), (x0, y0, _), change = water
        if change is None:
            self._water[:6] = (cn, ce, cd, x0, y0, 0.0)
        else:
            self._water[:] = (cn, ce, cd, x0, y0, 1.0, *change[0], *change[1])
        self._state[:] = state
        self._external[:] = external
        self._evaluate(*self._both)

    def turn(self, dt_s: float) -> None:
        """The thrusters turn for a while towards ``goal_n``."""
        self._turn(*self._both, dt_s)

    def step(self, dt_s: float) -> list[float]:
        """The state after a step from the last evaluated state, with the thrust of the last :meth:`turn`."""
        self._step(*self._both, dt_s)
        state: list[float] = self._state[:]
        return state

    def measured(self, held: bool) -> FloatArray:
        """The numbers of a Truth (33,), as :class:`.sitl.plant.Plant` lists them; ``held``: nothing accelerates it."""
        self._hull.held = held
        self._measure(*self._both)
        return self._numbers.copy()
