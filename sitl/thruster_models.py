"""Thrusters and their amplifiers: pulse -> thrust, with lag, and electrical power.

The amplifier reads whole microseconds and ignores changes inside its dead band. A brushed one applies the supply
voltage in proportion to the duty, F = c V |V| with a smaller constant astern; an ESC follows its manufacturer's
tables. Thrust has a first-order lag. The autopilot's allocation inverts this with its own code and its own, possibly
wrong, numbers.
"""

import math
from bisect import bisect_right
from collections.abc import MutableSequence, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from autopilot.core.thrusters import ThrustCurve, Thruster, ThrusterDrive, wrench_matrix
from autopilot.core.toml_table import Vec3
from autopilot.core.vehicle import Vehicle

if TYPE_CHECKING:
    from autopilot.sitl.compiled_hull import CompiledHull

OFF_US = 0
"""This pulse length means: no pulses."""

MOST_KNOWN = 4096
"""Pulses of a thruster of which is kept what they give: more than an amplifier tells apart."""


class Held(NamedTuple):
    """Steady thrust [N] of a held pulse at supply voltages [V]."""

    supply_v: tuple[float, ...]
    thrust_n: tuple[float, ...]

    def at(self, supply_v: float) -> float:
        """Steady thrust [N]: linear between the voltages, with the square of the voltage beyond them."""
        last = len(self.supply_v) - 1
        if not last:  # known at one voltage only
            ratio = supply_v / self.supply_v[0]
            return self.thrust_n[0] * (ratio * ratio)
        above = bisect_right(self.supply_v, supply_v)
        if 0 < above <= last:
            low, high = self.supply_v[above - 1], self.supply_v[above]
            one, other = self.thrust_n[above - 1], self.thrust_n[above]
            return one + (other - one) * (supply_v - low) / (high - low)
        end = min(above, last)
        ratio = supply_v / self.supply_v[end]
        return self.thrust_n[end] * (ratio * ratio)


def duty_from_pwm(drive: ThrusterDrive, pwm_us: float) -> float:
    """Duty in -1..1 of a pulse (rounded to whole us) at a brushed drive; 0 without pulses and inside the deadband."""
    whole_us = round(pwm_us)
    if whole_us == OFF_US:
        return 0.0
    duty = min(max((whole_us - drive.neutral_us) / drive.span_us, -1.0), 1.0)
    return duty if abs(duty) > drive.brushed_law[0] else 0.0


def held(drive: ThrusterDrive, pwm_us: float) -> Held:
    if drive.curve:
        return Held(
            tuple(curve.supply_v for curve in drive.curve), tuple(_on(curve, drive, pwm_us) for curve in drive.curve)
        )
    duty, (_, forward, reverse) = duty_from_pwm(drive, pwm_us), drive.brushed_law
    return Held((1.0,), ((forward if duty > 0.0 else reverse) * duty * abs(duty),))


def _on(curve: ThrustCurve, drive: ThrusterDrive, pwm_us: float) -> float:
    """Thrust [N] of a pulse on one curve."""
    whole_us = round(pwm_us)
    if whole_us == OFF_US:
        return 0.0
    whole_us = min(max(whole_us, drive.neutral_us - drive.span_us), drive.neutral_us + drive.span_us)
    right = min(max(bisect_right(curve.pulse_us, whole_us), 1), len(curve.pulse_us) - 1)
    low, high = curve.pulse_us[right - 1], curve.pulse_us[right]
    one, other = curve.thrust_n[right - 1], curve.thrust_n[right]
    return one + (other - one) * (whole_us - low) / (high - low)


def wrench_of(vehicle: Vehicle) -> tuple[tuple[float, ...], ...]:
    """(6, N) force and moment of 1 N of each thruster, where it really sits."""
    offsets, none = vehicle.body.thruster_offset_frd_m, (0.0, 0.0, 0.0)
    places: list[Vec3] = []
    for thruster in vehicle.thrusters:
        (x, y, z), (dx, dy, dz) = thruster.position_frd_m, offsets.get(thruster.name, none)
        places.append((x + dx, y + dy, z + dz))
    return wrench_matrix(places, [thruster.direction_frd for thruster in vehicle.thrusters])


class Thrusters:
    """The thrusters of one vehicle, in the order of its file."""

    def __init__(self, thrusters: Sequence[Thruster], compiled: "CompiledHull | None" = None) -> None:
        """``compiled`` keeps the numbers and turns the thrusters where it is given."""
        self._thrusters = tuple(thrusters)
        self._compiled = compiled
        count = len(self._thrusters)
        self._motor_n: MutableSequence[float] = [0.0] * count if compiled is None else compiled.motor_n
        self._gain: MutableSequence[float] = [1.0] * count if compiled is None else compiled.gain
        self._gain[:count] = [1.0] * count
        self._pwm_us: tuple[int, ...] | None = None
        self._held: list[Held] = []
        self._known: list[tuple[int, dict[int, Held], Thruster]] = [(t.channel - 1, {}, t) for t in self._thrusters]
        """Of each thruster its place among the pulses and what these give."""
        self._mean_n: MutableSequence[float] = [0.0] * count if compiled is None else compiled.mean_n

    @property
    def mean_n(self) -> list[float]:
        """Mean thrust over the last step, which acts on the body during that step [N]."""
        return list(self._mean_n[: len(self._thrusters)])

    @property
    def thrust_n(self) -> list[float]:
        """Acting thrust now [N], one per thruster."""
        count = len(self._thrusters)
        return [gain * motor for gain, motor in zip(self._gain[:count], self._motor_n[:count], strict=True)]

    @property
    def power_w(self) -> float:
        """Electrical power of all thrusters, sum of c |F|^1.5. A lossy thruster takes the power of a sound one."""
        if self._compiled is not None:
            return self._compiled.power_w
        total = 0.0
        for thruster, motor in zip(self._thrusters, self._motor_n, strict=True):
            drive, force = thruster.drive, abs(motor)
            astern = motor < 0.0 and drive.reverse_power_w_n15 is not None
            total += (drive.reverse_power_w_n15 or 0.0 if astern else drive.power_w_n15) * force * math.sqrt(force)
        return total

    def set_loss(self, index: int, loss: float) -> None:
        """From now on thruster ``index`` gives ``1 - loss`` of its thrust (0 = sound, 1 = none)."""
        if not 0.0 <= loss <= 1.0:
            raise ValueError(f"loss = {loss} is not between 0 and 1")
        self._gain[index] = 1.0 - loss

    def commanded(self, pwm_us: Sequence[int]) -> bool:
        """True if any pulse asks for thrust."""
        return any(thrust != 0.0 for one in self._holds(pwm_us) for thrust in one.thrust_n)

    def step(self, pwm_us: Sequence[int], supply_v: float, dt_s: float) -> None:
        """Hold the pulses (one per channel) and the supply for ``dt_s``. Exact solution of the lag; missing pulses are
        off."""
        pulses = tuple(pwm_us)
        if pulses != self._pwm_us:
            self._pwm_us, self._held = pulses, self._holds(pulses)
        goals = [one.at(supply_v) for one in self._held]
        if self._compiled is not None:
            self._compiled.goal_n[: len(goals)] = goals
            self._compiled.turn(dt_s)
            return
        motor_n, mean_n, gain = self._motor_n, self._mean_n, self._gain
        for index, (thruster, goal) in enumerate(zip(self._thrusters, goals, strict=True)):
            decay, mean_weight = _lag(thruster.drive.time_constant_s, dt_s)
            error = motor_n[index] - goal
            motor_n[index] = goal + decay * error
            mean_n[index] = gain[index] * (goal + mean_weight * error)

    def _holds(self, pwm_us: Sequence[int]) -> list[Held]:
        """Steady thrust curve of each thruster for the pulse on its channel."""
        result, count = [], len(pwm_us)
        for place, known, thruster in self._known:
            pulse = pwm_us[place] if place < count else OFF_US
            gives = known.get(pulse)
            if gives is None:
                if len(known) >= MOST_KNOWN:
                    known.clear()
                mirrored = thruster.reversed and pulse != OFF_US
                gives = held(thruster.drive, 2 * thruster.drive.neutral_us - pulse if mirrored else pulse)
                known[pulse] = gives
            result.append(gives)
        return result


@lru_cache(maxsize=16)
def _lag(tau_s: float, dt_s: float) -> tuple[float, float]:
    """exp(-dt / T) and its mean over ``dt_s``, for a first-order lag."""
    if tau_s == 0.0:
        return 0.0, 0.0
    decay = math.exp(-dt_s / tau_s)
    return decay, tau_s / dt_s * (1.0 - decay)
