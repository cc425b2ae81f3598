"""Faults of the machine: late ticks, a full disk, a changed clock, a killed process."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from autopilot.core.clock import TICK_US
from autopilot.core.messages import Authority, DeviceRole, DeviceTrouble, FlightControllerState, Inputs
from autopilot.drivers.ardusub_senders import OutputWatch
from autopilot.sitl.fault_tables import ClockJump, DiskFull, SecondSender, SlowLoop, WatchdogEnded
from autopilot.sitl.scenario_tables import Fault

STANDS_US = 20_000
"""What another has sent stands until the service's next command is read (50 Hz)."""
REPORT_US = 20_000


class SharedThrusters:
    """A second source of thruster commands beside the service: the last of two senders wins."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self._faults = [fault for fault in faults if isinstance(fault, SecondSender)]
        self._watch = OutputWatch()
        self._found: tuple[int, ...] = ()
        self._reported_us = 0

    @property
    def reported(self) -> bool:
        """Whether outputs are reported: in scenarios that need it."""
        return bool(self._faults)

    def pulses_us(self, t_us: int, ours: tuple[int, ...]) -> tuple[int, ...]:
        """Pulses at the outputs now [us]."""
        self._found = ours
        for fault in self._faults:
            if fault.holds(t_us) and round(t_us - 1e6 * fault.at_s) % round(1e6 / fault.rate_hz) < STANDS_US:
                self._found = tuple(pulse + round(fault.push_us) * (-1) ** place for place, pulse in enumerate(ours))
        return self._found

    def sent(self, t_us: int, pulses_us: tuple[int, ...]) -> None:
        if self._faults:
            self._watch.sent(t_us, pulses_us)

    def below(self, t_us: int, *, armed: bool) -> FlightControllerState | None:
        """As a flight controller reports it; None in a vehicle without one."""
        if not self._faults:
            return None
        if t_us - self._reported_us >= REPORT_US and self._found:
            self._reported_us = t_us
            self._watch.check(t_us, t_us & 0xFFFFFFFF, self._found, slow_heave=None)
        rival = armed and self._watch.rival
        pulses_us = self._found if rival else ()
        return FlightControllerState(
            t_us=t_us, authority=Authority.OURS, acts=True, pulses_us=pulses_us, armed=armed, rival=rival
        )


class MachineFaults:
    """State of the machine by the scenario's faults."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        faults = list(faults)
        self._slow = [fault for fault in faults if isinstance(fault, SlowLoop)]
        self._full = [fault for fault in faults if isinstance(fault, DiskFull)]
        self._jumps = [fault for fault in faults if isinstance(fault, ClockJump)]
        self._ended = [fault for fault in faults if isinstance(fault, WatchdogEnded)]
        self._none = not (self._slow or self._full or self._jumps or self._ended)
        self._late = 0.0

    def put_into(self, inputs: Inputs) -> Inputs:
        """A tick's inputs with the machine's faults in them."""
        if self._none:
            return inputs
        t_us = inputs.t_us
        self._late += max((fault.share for fault in self._slow if fault.holds(t_us)), default=0.0)
        jump_s = sum(j.jump_s for j in self._jumps if t_us - TICK_US < j.at_s * 1e6 <= t_us)
        ended = (DeviceTrouble(t_us=t_us, device=DeviceRole.WATCHDOG, text="has ended"),)
        return replace(
            inputs,
            troubles=inputs.troubles + (ended if any(fault.holds(t_us) for fault in self._ended) else ()),
            overruns=inputs.overruns + int(self._late),
            log_lost=inputs.log_lost or any(fault.holds(t_us) for fault in self._full),
            clock_jump_s=inputs.clock_jump_s + jump_s,
        )
