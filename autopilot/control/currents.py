"""What the controller believes of the water along its prediction: the estimate, a map corrected by it, or nothing."""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeAlias

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState

Field: TypeAlias = Callable[[tuple[float, float, float], float], tuple[float, float, float]]
"""Position NED [m] and time [s] -> velocity NED [m/s]."""


class CurrentForecast(Protocol):
    """Current at every stage of the prediction."""

    def view(self, nav: NavState) -> NavState:
        """The estimate as the controller is to take it."""
        ...

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Write the current (n, 3) at predicted positions (n, 3), ``t_s`` (n,) after ``nav``."""
        ...


class EstimatedCurrent:
    """The estimate holds over the whole horizon."""

    def view(self, nav: NavState) -> NavState:
        """Unchanged."""
        return nav

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """The same everywhere."""
        out[:] = nav.current_ned_m_s


class MappedCurrent:
    """A map of the current, shifted so that it agrees with the estimate where the vehicle is now."""

    def __init__(self, field: Field) -> None:
        self._field = field

    def view(self, nav: NavState) -> NavState:
        """Unchanged."""
        return nav

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Map at each predicted place plus what the estimate says the map lacks here."""
        now_s = nav.t_us * 1e-6
        here = np.array(self._at(nav.pos_ned_m, now_s))
        for k in range(len(out)):
            out[k] = self._at(pos_ned_m[k], now_s + float(t_s[k]))
        out += nav.current_ned_m_s - here

    def _at(self, pos_ned_m: FloatArray, t_s: float) -> tuple[float, float, float]:
        north, east, down = pos_ned_m.tolist()
        return self._field((north, east, down), t_s)


class NoCurrent:
    """Unaware of currents: speed over ground is taken for speed in the water."""

    def view(self, nav: NavState) -> NavState:
        """The estimate without a current."""
        return replace(nav, current_ned_m_s=np.zeros(3), vel_water_frd_m_s=nav.vel_frd_m_s)

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Still water."""
        out[:] = 0.0
