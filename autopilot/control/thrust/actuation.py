"""From commanded thrust to pulses and the expected thrust.

Combines the thruster curve, the effectiveness of each thruster and the command latency. Order within a tick:
:meth:`Actuation.send` at its beginning, :meth:`Actuation.learn` once the estimate is available,
:meth:`Actuation.command` (or :meth:`Actuation.neutral`) at its end.
"""

import math
from typing import NamedTuple

import numpy as np

from autopilot.control.thrust.actuation_delay import CommandDelay
from autopilot.control.thrust.allocation import Allocation
from autopilot.control.thrust.attitude_stabilisation import AttitudeStabilizer
from autopilot.control.thrust.losses import ThrusterLosses
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import MAX_THRUSTERS, Goal, NavState, ThrusterCommand, ThrusterHealthState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle

MUCH_N = 1e3
"""Above every thruster's limit: only the distribution counts."""

NO_LIFT = 1e-6
"""Less than this of a newton per newton of heave is rounding."""


class _Limits(NamedTuple):
    """Thrust (n,) [N] that is attainable, what of it stabilisation leaves, and what of this THR_LIMIT; of the sound
    thrusters' capability, effectiveness and THR_LIMIT by which they were found."""

    sound_n: FloatArray
    effectiveness: FloatArray
    limit_n: float
    can_n: FloatArray
    free_n: FloatArray
    command_n: FloatArray


class Actuation:
    """All n thrusters of a vehicle, in the order of its file."""

    def __init__(self, vehicle: Vehicle, params: ParamSet) -> None:
        self._allocator = ControlAllocator.of(vehicle)
        self._params = params
        self.losses = ThrusterLosses(vehicle, params)
        self.delay = CommandDelay(vehicle, params)
        self._levelling = AttitudeStabilizer(vehicle)
        self._nav: NavState | None = None
        self._count = self._allocator.model.thrusters
        self._pulse_n = self.nothing()
        """Thrust of healthy thrusters for the pulses of the last command."""
        self.allocation = Allocation(vehicle.thrusters)
        self.supply_v: float | None = None
        """Measured voltage, None = nominal."""
        self._limits = self._limits_of(self.allocation.capability_n(), self.losses.effectiveness, math.inf)

    def nothing(self) -> FloatArray:
        """Zero thrust (n,)."""
        return np.zeros(self._count)

    # What is known

    @property
    def limit_n(self) -> FloatArray:
        """(n,) thrust limits of the controller [N] at the present supply voltage, after faults and the part reserved
        for attitude stabilisation. Not to be written to.
        """
        return self._present_limits.free_n

    @property
    def command_limit_n(self) -> FloatArray:
        """(n,) the same within THR_LIMIT: the bounds of every command. Not to be written to."""
        return self._present_limits.command_n

    @property
    def _present_limits(self) -> "_Limits":
        sound_n, effectiveness = self.allocation.capability_n(self.supply_v), self.losses.effectiveness
        last, limit_n = self._limits, self._params["THR_LIMIT"]
        if last.sound_n is not sound_n or last.effectiveness is not effectiveness or last.limit_n != limit_n:
            self._limits = self._limits_of(sound_n, effectiveness, limit_n)
        return self._limits

    def _limits_of(self, sound_n: FloatArray, effectiveness: FloatArray, limit_n: float) -> "_Limits":
        can_n = sound_n * effectiveness
        free_n = can_n - self._levelling.reserve_n(can_n)
        found = _Limits(sound_n, effectiveness, limit_n, can_n, free_n, np.minimum(free_n, limit_n))
        for each_n in (found.can_n, found.free_n, found.command_n):
            each_n.setflags(write=False)
        return found

    # One tick

    def not_taken(self) -> None:
        """The last command has not reached the thrusters: they stand."""
        self._pulse_n = self.nothing()

    def taken(self, pulses_us: tuple[int, ...]) -> None:
        """Another source commands the thrusters with these pulses; () = unknown, treated as neutral."""
        known = len(pulses_us) == self._count
        self._pulse_n = self.allocation.thrusts_n(pulses_us, self.supply_v) if known else self.nothing()

    def send(self, t_us: int) -> FloatArray:
        """Register the last command as sent. Returns (n,) the thrust of healthy thrusters that acts now [N]."""
        return self.delay.send(t_us, self._pulse_n)

    def learn(
        self,
        t_us: int,
        nav: NavState | None,
        acting_n: FloatArray,
        goal: Goal | None,
        *,
        armed: bool,
        reached: bool,
        alone: bool = True,
    ) -> ThrusterHealthState | None:
        """Update latency and effectiveness from the present estimate and the result of :meth:`send`.

        ``reached``: the device accepts commands. ``alone``: no other source commands the thrusters, so that motion
        shows the latency. Returns a record for the log, periodically.
        """
        self._nav = nav
        capability_n = self.allocation.capability_n(self.supply_v)
        self.delay.step(t_us, nav, armed=armed and alone)
        # Commands that never reached the thrusters are no evidence.
        prompt = armed and self.delay.prompt and reached
        return self.losses.step(t_us, nav, acting_n, capability_n, goal, armed=prompt)

    def lift_n(self, limit_n: float) -> FloatArray:
        """(n,) straight up, the thruster that has to give most giving ``limit_n``; nothing when none can lift."""
        wanted = np.array([0.0, 0.0, -1.0, 0.0])
        up = self._allocator.thrust_n(wanted, np.where(self.losses.effectiveness > 0.0, MUCH_N, 0.0))
        most = float(np.abs(up).max())
        if most < NO_LIFT:
            return self.nothing()
        up[np.abs(up) < NO_LIFT * most] = 0.0
        return up * (limit_n / most)

    def command(self, t_us: int, thrust_n: FloatArray, *, armed: bool, levels: bool = True) -> ThrusterCommand:
        """Pulses for thrust (n,), with that which ``levels`` the vehicle; neutral ones while disarmed. ValueError if
        it is not finite: no thruster turns for a command of which one part is no number."""
        if not armed:
            self._pulse_n = self.nothing()
            return self._command(t_us, self._pulse_n, self.allocation.neutral_us)
        if levels and self._nav is not None and self._levelling.given:
            tilt, turning = self._nav.rpy_rad, self._nav.rate_frd_rad_s
            limits = self._present_limits
            thrust_n = self._levelling.thrust_n(thrust_n, limits.can_n, limits.command_n, tilt, turning)
        if not all(map(math.isfinite, thrust_n.tolist())):
            raise ValueError(f"thrust is not finite: {thrust_n.tolist()}")
        pulses_us = self.allocation.pulses_us(thrust_n, self.supply_v, self.losses.effectiveness)
        # Thrust of the pulses, dead band and saturation included: input of the estimator's model.
        self._pulse_n = self.allocation.thrusts_n(pulses_us, self.supply_v)
        return self._command(t_us, thrust_n, pulses_us, armed=True)

    def neutral(self, t_us: int) -> ThrusterCommand:
        """No thrust; needs nothing that could fail."""
        self._pulse_n = self.nothing()
        return self._command(t_us, self._pulse_n, self.allocation.neutral_us)

    def _command(
        self, t_us: int, thrust_n: FloatArray, pulses_us: tuple[int, ...], *, armed: bool = False
    ) -> ThrusterCommand:
        padded_n = np.zeros(MAX_THRUSTERS)
        padded_n[: self._count] = thrust_n
        padded_us = pulses_us + (0,) * (MAX_THRUSTERS - self._count)
        return ThrusterCommand(t_us=t_us, thrust_n=padded_n, pwm_us=padded_us, armed=armed)
