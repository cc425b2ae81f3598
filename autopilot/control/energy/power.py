"""Energy of motion: J = integral of (hotel power + sum of c |F|^1.5) dt."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from autopilot.control.energy.energy_tuning import POWER
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import AXES, Model4
from autopilot.core.vehicle import Vehicle


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerModel:
    hotel_w: float
    thrust_w_n15: tuple[float, ...]
    """c in P = c |F|^1.5 of each of the n thrusters, ahead."""
    reverse_w_n15: tuple[float, ...] = ()
    """The same astern; () = as ahead."""

    @classmethod
    def of(cls, vehicle: Vehicle) -> "PowerModel":
        drives = [thruster.drive for thruster in vehicle.thrusters]
        ahead = tuple(drive.power_w_n15 for drive in drives)
        astern = tuple(drive.reverse_power_w_n15 or drive.power_w_n15 for drive in drives)
        return cls(hotel_w=vehicle.hotel_power_w, thrust_w_n15=ahead, reverse_w_n15=() if astern == ahead else astern)

    def thrust_w(self, thrust_n: Any) -> Any:
        """Power of each thruster at ``thrust_n``: (..., n) or CasADi columns (n, m)."""
        return self._each(thrust_n) * (thrust_n * thrust_n + POWER.thrust_smoothing_n2) ** 0.75

    def secant_over_tangent(self, thrust_n: Any) -> Any:
        """Excess of P'(F) / F over P''(F) [W/N2]."""
        squared = thrust_n * thrust_n
        return 0.75 * self._each(thrust_n) * squared * (squared + POWER.thrust_smoothing_n2) ** -1.25

    def _each(self, thrust_n: Any) -> Any:
        """c of every thruster at its thrust; from one side to the other it goes over smoothly (10 mN)."""
        ahead = _like(thrust_n, self.thrust_w_n15)
        if not self.reverse_w_n15:
            return ahead
        astern = _like(thrust_n, self.reverse_w_n15)
        direction = thrust_n * (thrust_n * thrust_n + POWER.thrust_smoothing_n2) ** -0.5
        return 0.5 * (ahead + astern) + 0.5 * (ahead - astern) * direction


def _like(thrust_n: Any, values: Sequence[float]) -> Any:
    """Values (n,) to be multiplied with thrusts (..., n) or CasADi columns (n, m)."""
    return np.array(values) if isinstance(thrust_n, np.ndarray) else ca.repmat(ca.DM(values), 1, thrust_n.shape[1])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SpeedTable:
    """Power (m,) [W], hotel included, at steady speeds (m,) [m/s] ahead through the water."""

    speed_m_s: FloatArray
    power_w: FloatArray
    cruise_m_s: float = math.inf
    """See :func:`planar_limit_m_s`."""

    def allowed(self, along_m_s: FloatArray, across_m_s: FloatArray) -> NDArray[np.bool_]:
        """(m, n) which speeds of the table the cruise speed allows; the next faster one stands for the limit itself."""
        limit = planar_limit_m_s(self, along_m_s, across_m_s) + self.speed_m_s[1]
        result: NDArray[np.bool_] = self.speed_m_s[:, None] <= limit
        return result


def speed_table(
    model: Model4, power: PowerModel, top_m_s: float, cruise_m_s: float = math.inf, count: int = 24
) -> SpeedTable:
    """Steady surge through the water from rest to ``top_m_s``, at its depth, on the thrusters that it takes."""
    speed = np.linspace(0.0, top_m_s, count)
    force = np.zeros((count, AXES))
    force[:, 0] = (model.linear_drag[0] + model.quadratic_drag[0] * speed) * speed
    force[:, 2] = model.buoyancy_excess_n
    thrust = ControlAllocator(model, power.thrust_w_n15).thrust_n(force, np.full(model.thrusters, np.inf))
    watts = power.thrust_w(thrust)[:, np.abs(thrust).max(axis=0) > POWER.idle_n]
    return SpeedTable(speed_m_s=speed, power_w=power.hotel_w + watts.sum(axis=1), cruise_m_s=cruise_m_s)


def planar_limit_m_s(table: SpeedTable, along_m_s: FloatArray, across_m_s: FloatArray) -> FloatArray:
    """Limit on the speed through the water (m,) by the cruise speed, in currents along and across the path (m,).

    Against a current it limits the speed over ground, with a current the speed relative to the water: a following
    current is not braked against.
    """
    return np.hypot(table.cruise_m_s + np.maximum(-along_m_s, 0.0), across_m_s)


def energy_per_metre(table: SpeedTable, along_m_s: FloatArray, across_m_s: FloatArray) -> FloatArray:
    """Minimum energy per metre over ground (m,) [J/m] in currents along and across the path (m,).

    Min over u of P(u) / (sqrt(u^2 - across^2) + along); inf where no speed of the table makes headway.
    """
    least: FloatArray = np.empty(len(along_m_s))
    u = table.speed_m_s[:, None]
    for begin in range(0, len(least), POWER.together):
        part = slice(begin, begin + POWER.together)
        across, along = across_m_s[part], along_m_s[part]
        radicand = u * u - across * across
        ground = np.sqrt(np.maximum(radicand, 0.0)) + along
        usable = (radicand >= 0.0) & (ground > POWER.slowest_ground_m_s) & table.allowed(along, across)
        least[part] = np.where(usable, table.power_w[:, None] / np.where(usable, ground, 1.0), np.inf).min(axis=0)
    return least
