"""Faults of the machine: late ticks, a full disk, a changed clock, a killed process."""

from collections.abc import Iterable
from dataclasses import replace

from autopilot.core.clock import TICK_US
from autopilot.core.messages import DeviceRole, DeviceTrouble, Inputs
from autopilot.sitl.fault_tables import ClockJump, DiskFull, SlowLoop, WatchdogEnded
from autopilot.sitl.scenario_tables import Fault


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
