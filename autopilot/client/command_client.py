"""Command protocol, client side (https://mavlink.io/en/services/command.html)."""

from collections.abc import Sequence

from pymavlink.dialects.v20 import development as mav

from autopilot.client.exchange import BaseExchange, ExchangeResult, Message, Timers, VehicleAddress


class CommandSend(BaseExchange):
    """One COMMAND_LONG, retransmitted until its final COMMAND_ACK; IN_PROGRESS stops the retransmission."""

    def __init__(
        self,
        command: int,
        params: Sequence[float] = (),
        target: VehicleAddress | None = None,
        timers: Timers | None = None,
    ) -> None:
        super().__init__(target or VehicleAddress(), timers or Timers(), f"command {command}")
        self._command = command
        self._params = (*params, *(0.0,) * (7 - len(params)))
        self._confirmation = 0
        self._percent = 0
        self._running = False

    @property
    def progress(self) -> tuple[int, int]:
        """Per cent done, and 100."""
        return self._percent, 100

    def begin(self, t_s: float) -> list[Message]:
        self._start(t_s)
        return [self._message()]

    def handle(self, message: Message, t_s: float) -> list[Message]:
        if not self._listens(message, t_s):
            return []
        if message.get_type() == "COMMAND_ACK" and message.command == self._command:
            self._received_s = t_s
            if message.result == mav.MAV_RESULT_IN_PROGRESS:
                self._running = True
                self._percent = message.progress if message.progress <= 100 else self._percent
            elif message.result == mav.MAV_RESULT_ACCEPTED:
                self.outcome = ExchangeResult(result=0, reason="")
            else:
                self._refuse(message.result, t_s)
        return []

    def tick(self, t_s: float) -> list[Message]:
        """Retransmit with an incremented confirmation number, unless the vehicle has answered IN_PROGRESS."""
        if self._waits(t_s) or self._running or t_s - self._sent_s < self._timers.general_s:
            return []
        self._sent_s = t_s
        self._confirmation = min(self._confirmation + 1, 255)
        return [self._message()]

    def _message(self) -> Message:
        target = self._target
        return mav.MAVLink_command_long_message(
            target.system, target.component, self._command, self._confirmation, *self._params
        )
