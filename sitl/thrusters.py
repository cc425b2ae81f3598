"""Thrusters and their amplifiers: pulse -> duty -> voltage -> thrust, with lag, and the electrical power they take.

Each step is what the hardware does: the amplifier sees whole microseconds, ignores duties inside its deadband and
passes on the supply voltage in proportion; a brushed thruster gives F = c V |V| with a weaker constant in reverse, and
reaches it with a first-order lag. The allocation of the autopilot inverts this from its own, possibly wrong, numbers.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

from autopilot.core.vehicle import Drive

OFF_US = 0
"""This pulse length means: no pulses."""


def duty_from_pwm(drive: Drive, pwm_us: float) -> float:
    """Duty in -1..1 of a pulse (rounded to whole us); 0 without pulses and inside the deadband."""
    whole_us = round(pwm_us)
    if whole_us == OFF_US:
        return 0.0
    duty = min(max((whole_us - drive.neutral_us) / drive.span_us, -1.0), 1.0)
    return duty if abs(duty) > drive.deadband_duty else 0.0


def steady_thrust_n(drive: Drive, pwm_us: float, supply_v: float) -> float:
    """Thrust [N] that a pulse settles at, for a supply voltage [V]."""
    volt = duty_from_pwm(drive, pwm_us) * supply_v
    return (drive.forward_n_v2 if volt > 0.0 else drive.reverse_n_v2) * volt * abs(volt)


class Thrusters:
    """The thrusters of one vehicle, in the order of its file."""

    def __init__(self, drive: Drive, count: int) -> None:
        self._drive = drive
        self._count = count
        self._motor_n = [0.0] * count
        self._gain = [1.0] * count
        self._pwm_us: tuple[int, ...] = ()
        self._constant = [0.0] * count
        self.mean_n = [0.0] * count
        """Acting thrust, averaged over the last step: what the body feels during that step [N]."""

    @property
    def thrust_n(self) -> list[float]:
        """Acting thrust now [N], one per thruster."""
        return [gain * motor for gain, motor in zip(self._gain, self._motor_n, strict=True)]

    @property
    def power_w(self) -> float:
        """Electrical power of all thrusters, sum of c |F|^1.5. A lossy thruster takes the power of a sound one."""
        total = 0.0
        for motor in self._motor_n:
            force = abs(motor)
            total += force * math.sqrt(force)
        return self._drive.power_w_n15 * total

    def set_loss(self, index: int, loss: float) -> None:
        """From now on thruster ``index`` gives ``1 - loss`` of its thrust (0 = sound, 1 = none)."""
        if not 0.0 <= loss <= 1.0:
            raise ValueError(f"loss = {loss} is not between 0 and 1")
        self._gain[index] = 1.0 - loss

    def commanded(self, pwm_us: Sequence[int]) -> bool:
        """True if any pulse asks for thrust."""
        return any(duty_from_pwm(self._drive, pulse) != 0.0 for pulse in pwm_us[: self._count])

    def step(self, pwm_us: Sequence[int], supply_v: float, dt_s: float) -> None:
        """Hold the pulses and the supply for ``dt_s``. Exact solution of the lag; missing pulses are off."""
        pulses = tuple(pwm_us)
        if pulses != self._pwm_us:
            self._pwm_us = pulses
            padded = (*pulses, *(OFF_US for _ in range(self._count)))
            self._constant = [steady_thrust_n(self._drive, pulse, 1.0) for pulse in padded[: self._count]]
        decay, mean_weight = _lag(self._drive.time_constant_s, dt_s)
        square = supply_v * supply_v
        motor_n, mean_n, gain = self._motor_n, self.mean_n, self._gain
        for index, constant in enumerate(self._constant):
            goal = constant * square
            error = motor_n[index] - goal
            motor_n[index] = goal + decay * error
            mean_n[index] = gain[index] * (goal + mean_weight * error)


@lru_cache(maxsize=16)
def _lag(tau_s: float, dt_s: float) -> tuple[float, float]:
    """What is left of an error after ``dt_s``, and its mean over that time, for a first-order lag."""
    if tau_s == 0.0:
        return 0.0, 0.0
    decay = math.exp(-dt_s / tau_s)
    return decay, tau_s / dt_s * (1.0 - decay)
