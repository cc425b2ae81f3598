"""Command protocol, client side (https://mavlink.io/en/services/command.html), and questions that the vehicle
answers by one message: a parameter, or a message on request."""

import math
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import development as mav

from autopilot.client.exchange import Exchange, ExchangeResult, Message, Timers, VehicleAddress


class CommandSend(Exchange):
    """One COMMAND_LONG, retransmitted until its final COMMAND_ACK; IN_PROGRESS stops the retransmission."""

    def __init__(
        self,
        command: int,
        params: Sequence[float] = (),
        target: VehicleAddress | None = None,
        timers: Timers | None = None,
    ) -> None:
        super().__init__(f"command {command}", target, timers)
        self._command = command
        self._params = (*params, *(0.0,) * (7 - len(params)))
        self._confirmation = -1
        self._percent = 0
        self._running = False

    @property
    def progress(self) -> tuple[int, int]:
        """Per cent done, and 100."""
        return self._percent, 100

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

    @property
    def _repeat_s(self) -> float:
        return math.inf if self._running else self._timers.general_s

    def _due(self) -> Message:
        """With an incremented confirmation number each time that it is sent."""
        self._confirmation = min(self._confirmation + 1, 255)
        target = self._target
        return mav.MAVLink_command_long_message(
            target.system, target.component, self._command, self._confirmation, *self._params
        )


class Question(Exchange):
    """Sends ``question`` again until a message for which ``answers`` is true arrives, or a refusal."""

    def __init__(
        self,
        question: Message,
        answers: Callable[[Message], bool],
        what: str,
        target: VehicleAddress,
        timers: Timers | None = None,
    ) -> None:
        super().__init__(what, target, timers)
        self._question, self._answers = question, answers
        self.answer: Message | None = None

    @property
    def progress(self) -> tuple[int, int]:
        """Answers, and 1."""
        return int(self.answer is not None), 1

    def _due(self) -> Message:
        return self._question

    def handle(self, message: Message, t_s: float) -> list[Message]:
        if not self._listens(message, t_s):
            return []
        if self._answers(message):
            self.answer = message
            self.outcome = ExchangeResult(result=0, reason="")
        elif (
            message.get_type() == "COMMAND_ACK"
            and message.command == getattr(self._question, "command", None)
            # "Not yet" is asked again.
            and message.result not in (mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_TEMPORARILY_REJECTED)
        ):
            self._refuse(message.result, t_s)
        return []


def parameter_question(name: str, target: VehicleAddress, timers: Timers | None = None) -> Question:
    """PARAM_REQUEST_READ by name; the answer is its PARAM_VALUE."""
    return Question(
        mav.MAVLink_param_request_read_message(target.system, target.component, name.encode("ascii"), -1),
        lambda message: message.get_type() == "PARAM_VALUE" and message.param_id == name,
        f"parameter {name}",
        target,
        timers,
    )


def message_question(message_id: int, target: VehicleAddress, timers: Timers | None = None) -> Question:
    """MAV_CMD_REQUEST_MESSAGE; the answer is that message."""
    return Question(
        mav.MAVLink_command_long_message(
            target.system, target.component, mav.MAV_CMD_REQUEST_MESSAGE, 0, float(message_id), *(0.0,) * 6
        ),
        lambda message: message.get_msgId() == message_id,
        mav.mavlink_map[message_id].msgname,
        target,
        timers,
    )
