"""A simulated operator in simulated time: arms and starts the plan on board, over MAVLink.

Runs in the process and time of the service (:class:`autopilot.run.outside.InProcessClient`), so that a whole mission
is reproducible bit for bit.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from autopilot.sitl.fault_tables import LinkLoss, PilotFault
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sitl_tuning import OPERATOR

Order = tuple[int, tuple[float, ...]]
"""A command (MAV_CMD) and its first parameters, the others are 0."""

ARM: Order = (OPERATOR.arm, (1.0,))
START: Order = (OPERATOR.start, ())


class ScriptedOperator:
    """Gives its orders one after the other, each until accepted, and keeps its heartbeat going."""

    def __init__(
        self, target_system: int, faults: Iterable[Fault] = (), *, orders: Sequence[Order] = (ARM, START)
    ) -> None:
        from pymavlink.dialects.v20 import development

        self._dialect = development
        self._mav = development.MAVLink(None, srcSystem=OPERATOR.gcs_system, srcComponent=OPERATOR.gcs_component)
        self._mav.robust_parsing = True
        self.target_system = target_system
        faults = list(faults)
        self._lost = [fault for fault in faults if isinstance(fault, LinkLoss)]
        self._steers = [fault for fault in faults if isinstance(fault, PilotFault)]
        self._todo = list(orders)
        self._sent_us: int | None = None
        self._ready: bool | None = None
        """Whether arming would be accepted, as the vehicle said last."""
        self._heartbeat_us = -OPERATOR.heartbeat_us

    @property
    def started(self) -> bool:
        return not self._todo

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        """One tick: read replies, send due messages."""
        if any(fault.holds(t_us) for fault in self._lost):
            return []
        if self._todo:
            for data in received:
                for message in self._mav.parse_buffer(data) or ():
                    self._receive(message)
        out: list[bytes] = []
        if self._sent_us is None:
            self._sent_us = t_us  # the vehicle needs a second until its sensors have reported
            out.append(self._command(OPERATOR.set_interval, (OPERATOR.sys_status, OPERATOR.ready_us)))
        if t_us - self._heartbeat_us >= OPERATOR.heartbeat_us:
            self._heartbeat_us = t_us
            out.append(self._pack(self._mav.heartbeat_encode(6, 8, 0, 0, 4)))
        # A refusal tells the reason: after a while it is asked for.
        waits = bool(self._todo) and self._todo[0] is ARM and self._ready is False and t_us < OPERATOR.patience_us
        if self._todo and not waits and t_us - self._sent_us >= OPERATOR.retry_us:
            self._sent_us = t_us
            out.append(self._command(*self._todo[0]))
        if t_us % OPERATOR.stick_us == 0 and any(fault.holds(t_us) for fault in self._steers):
            out.append(self._pack(self._mav.manual_control_encode(self.target_system, 0, 0, 500, 0, 0)))
        return out

    def _command(self, command: int, given: tuple[float, ...]) -> bytes:
        params = (*given, *(0.0,) * (7 - len(given)))
        return self._pack(self._mav.command_long_encode(self.target_system, 1, command, 0, *params))

    def _receive(self, message: Any) -> None:
        if message.get_type() == "SYS_STATUS":
            self._ready = bool(message.onboard_control_sensors_health & self._dialect.MAV_SYS_STATUS_PREARM_CHECK)
        answered = message.get_type() == "COMMAND_ACK" and self._todo and message.command == self._todo[0][0]
        if answered and message.result == 0:
            self._todo.pop(0)
            self._sent_us = -OPERATOR.retry_us

    def _pack(self, message: Any) -> bytes:
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) & 0xFF
        return data
