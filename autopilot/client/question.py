"""A question that the vehicle answers by one message: a parameter, or a message on request."""

from collections.abc import Callable

from pymavlink.dialects.v20 import development as mav

from autopilot.client.exchange import BaseExchange, ExchangeResult, Message, Timers, VehicleAddress


class Question(BaseExchange):
    """Sends ``question`` again until a message for which ``answers`` is true arrives, or a refusal."""

    def __init__(
        self,
        question: Message,
        answers: Callable[[Message], bool],
        what: str,
        target: VehicleAddress,
        timers: Timers | None = None,
    ) -> None:
        super().__init__(target, timers or Timers(), what)
        self._question, self._answers = question, answers
        self.answer: Message | None = None

    @property
    def progress(self) -> tuple[int, int]:
        """Answers, and 1."""
        return int(self.answer is not None), 1

    def begin(self, t_s: float) -> list[Message]:
        self._start(t_s)
        return [self._question]

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

    def tick(self, t_s: float) -> list[Message]:
        if self._waits(t_s) or t_s - self._sent_s < self._timers.general_s:
            return []
        self._sent_s = t_s
        return [self._question]


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
