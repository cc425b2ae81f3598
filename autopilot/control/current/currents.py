"""Current along the prediction: estimated, from a map with a correction, learned, or none."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeAlias

import numpy as np

from autopilot.control.current.current_memory import CurrentMemory
from autopilot.control.current.current_tuning import CURRENTS
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import NavHealth, NavState

Pointwise: TypeAlias = Callable[[tuple[float, float, float], float], tuple[float, float, float]]
"""Position NED [m] and time [s] -> velocity NED [m/s]."""


class CurrentForecast(Protocol):
    """Current at every stage of the prediction."""

    def view(self, nav: NavState) -> NavState:
        """The estimate as the controller is to take it; called once per control step, before everything else."""
        ...

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Write the current (n, 3) at predicted positions (n, 3), ``t_s`` (n,) after ``nav``."""
        ...

    def revision(self, nav: NavState) -> int:
        """Grows when the forecast is another one (by MATERIAL_M_S) than at the last revision: time to plan anew."""
        ...

    def within(self, fence: Fence) -> None:
        """Learn of the fence in force; called when there is another one."""
        ...


class KnownCurrent(Protocol):
    """A current given in advance: :class:`autopilot.control.current.current_map.CurrentMap`, or a formula."""

    @property
    def scale_m(self) -> float:
        """Length scale of the current and of its error [m]."""
        ...

    def velocity(self, pos_ned_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """(m, 3) NED [m/s] at places (m, 3) and times (m,) of the service's clock."""
        ...

    def drift_m_s(self, before_s: float, after_s: float) -> float:
        """Upper bound of its change between two times [m/s]."""
        ...


class PointwiseField:
    """A formula for one place as a :class:`KnownCurrent`."""

    def __init__(self, field: Pointwise, scale_m: float = CURRENTS.tank_scale_m) -> None:
        self._field = field
        self.scale_m = scale_m

    def velocity(self, pos_ned_m: FloatArray, t_s: FloatArray) -> FloatArray:
        field = self._field
        places, times = pos_ned_m.tolist(), t_s.tolist()
        return np.array([field((x, y, z), t) for (x, y, z), t in zip(places, times, strict=True)]).reshape(-1, 3)

    def drift_m_s(self, before_s: float, after_s: float) -> float:
        """Looked at in the origin: formulas change everywhere alike (tides) or not at all."""
        here = (0.0, 0.0, 0.0)
        return math.dist(self._field(here, before_s), self._field(here, after_s))


def _no_drift(before_s: float, after_s: float) -> float:
    """Time derivative of a steady current: zero."""
    return 0.0


class Revision:
    """Counts how often a vector has moved by MATERIAL_M_S, or time by as much as changes a field so far."""

    def __init__(self, drift_m_s: Callable[[float, float], float] = _no_drift) -> None:
        self._drift_m_s = drift_m_s
        self._seen_m_s: FloatArray | None = None
        self._seen_s = 0.0
        self.count = 0

    def update(self, value_m_s: FloatArray, now_s: float) -> int:
        """The revision after comparison with a vector (3,)."""
        if self._seen_m_s is None:
            self._seen_m_s, self._seen_s = value_m_s.copy(), now_s
        moved_m_s = float(np.abs(value_m_s - self._seen_m_s).max())
        if moved_m_s > CURRENTS.material_m_s or self._drift_m_s(self._seen_s, now_s) > CURRENTS.material_m_s:
            self._seen_m_s, self._seen_s = value_m_s.copy(), now_s
            self.count += 1
        return self.count


class _Anywhere:
    """A forecast that does not depend on the fence."""

    def within(self, fence: Fence) -> None:
        """No-op: nothing to learn."""


class EstimatedCurrent(_Anywhere):
    """The estimate holds over the whole horizon."""

    def __init__(self) -> None:
        self._revision = Revision()

    def view(self, nav: NavState) -> NavState:
        return nav

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        out[:] = nav.current_ned_m_s

    def revision(self, nav: NavState) -> int:
        return self._revision.update(nav.current_ned_m_s, nav.t_us * 1e-6)


class MappedCurrent(_Anywhere):
    """A current map, corrected by its residual against the estimate: near visited positions the stored one, elsewhere
    the present one.
    """

    def __init__(self, field: KnownCurrent) -> None:
        self._field = field
        self._memory = CurrentMemory(field.scale_m)
        self._revision = Revision(field.drift_m_s)

    def view(self, nav: NavState) -> NavState:
        numbers = (*nav.current_ned_m_s.tolist(), *nav.pos_ned_m.tolist())
        if nav.health is NavHealth.GOOD and all(map(math.isfinite, numbers)):
            here = self._field.velocity(nav.pos_ned_m[None], np.array([nav.t_us * 1e-6]))[0]
            variance = 0.5 * (nav.variance.item(9) + nav.variance.item(10))
            self._memory.learn(nav.t_us, nav.pos_ned_m, nav.current_ned_m_s - here, variance)
        return nav

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Map and memory at each predicted place and time, plus the correction as far as it holds there and then."""
        forecast = self._forecast(nav, np.vstack((pos_ned_m, nav.pos_ned_m)), np.append(t_s, 0.0))
        out[:] = forecast[:-1]
        fraction = correction_fraction(nav, pos_ned_m, t_s, self._field.scale_m)
        out += fraction[:, None] * (nav.current_ned_m_s - forecast[-1])

    def revision(self, nav: NavState) -> int:
        """The estimate surprises by something else than at the last revision, or the map has moved on."""
        here = self._forecast(nav, nav.pos_ned_m[None], np.zeros(1))[0]
        return self._revision.update(nav.current_ned_m_s - here, nav.t_us * 1e-6)

    def _forecast(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """(n, 3) map and memory at places, ``t_s`` after ``nav``."""
        on_map = self._field.velocity(pos_ned_m, t_s + nav.t_us * 1e-6)
        return on_map + self._memory.recall(nav.t_us, pos_ned_m, np.zeros(3))


def correction_fraction(
    nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, scale_m: float = CURRENTS.tank_scale_m
) -> FloatArray:
    """(n,) how much of the present correction holds at places and times: all of it round the vehicle, within LASTING_S.

    A vehicle that holds its goal predicts to stay there. A correction that faded along that prediction would announce a
    current that never comes, and the plan would lean against it: an offset from the goal. Hence no fading in time
    within the horizon, and none in space within the acceptance ball.
    """
    distance_m = np.maximum(np.sqrt(np.square(pos_ned_m - nav.pos_ned_m).sum(axis=1)) - CURRENTS.full_within_m, 0.0)
    fraction: FloatArray = np.exp(
        -0.5 * np.square(distance_m / scale_m) - np.maximum(t_s - CURRENTS.lasting_s, 0.0) / CURRENTS.fade_s
    )
    return fraction


class NoCurrent(_Anywhere):
    """Unaware of currents: speed over ground is taken for speed in the water."""

    def view(self, nav: NavState) -> NavState:
        return replace(nav, current_ned_m_s=np.zeros(3), vel_water_frd_m_s=nav.vel_frd_m_s)

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        out[:] = 0.0

    def revision(self, nav: NavState) -> int:
        return 0
