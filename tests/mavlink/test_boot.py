"""What a service says on its links before it can do anything: who gets which answer, and what is left for later."""

import time
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav

from autopilot.core.errors import DriverError
from autopilot.mavlink.boot import MAX_PARSERS, STARTING, BootLink
from autopilot.mavlink.wire import LinkParser
from autopilot.run.boot_links import TURN_S, BootLinks
from drivers.protocols import Received

ARM = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
COUNT = mav.MAVLink_mission_count_message(1, 1, 3, 0)
FENCE_COUNT = mav.MAVLink_mission_count_message(1, 1, 5, 1)
SET_MODE = mav.MAVLink_set_mode_message(1, 217, 4)


def packed(*messages: Any) -> bytes:
    sender = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    return b"".join(bytes(message.pack(sender)) for message in messages)


def kinds(*data: bytes) -> list[str]:
    parser = LinkParser()
    return [message.get_type() for piece in data for message in parser.feed(piece)]


def test_requests_beside_an_action_are_left_and_the_action_is_not() -> None:
    boot = BootLink(1, "generic")
    answers, left = boot.answer(packed(COUNT, ARM, FENCE_COUNT, COUNT))
    assert kinds(*answers) == ["STATUSTEXT", "COMMAND_ACK"]
    assert kinds(*left.values()) == ["MISSION_COUNT", "MISSION_COUNT"], "what is asked again is asked once"
    answers, left = boot.answer(packed(COUNT))
    assert (answers, list(left.values())) == ([], [packed(COUNT)])


def test_a_mode_is_put_off_as_well() -> None:
    answers, left = BootLink(1, "generic").answer(packed(SET_MODE))
    assert not left
    (text,) = LinkParser().feed(b"".join(answers))
    assert text.text == STARTING
    other = packed(mav.MAVLink_set_mode_message(7, 217, 4))
    answers, left = BootLink(1, "generic").answer(other)
    assert (answers, list(left.values())) == ([], [other]), "another vehicle's"


def test_half_a_message_of_one_client_does_not_meet_anothers() -> None:
    boot, data = BootLink(1, "generic"), packed(ARM)
    assert boot.answer(data[:20], 1)[0] == []
    assert boot.answer(b"\0" * 30, 2)[0] == []
    assert len(boot.answer(data[20:], 1)[0]) == 2
    for client in range(2 * MAX_PARSERS):
        boot.answer(data[:20], client)
    assert len(boot._parsers) == MAX_PARSERS


class Line:
    """A link in memory; raises what it is told to."""

    name, problem, dropped_tx = "line", None, 0

    def __init__(self) -> None:
        self.error: Exception | None = None
        self.inbox: list[bytes] = []
        self.sent: list[bytes] = []

    def recv(self, t_us: int) -> list[Received]:
        if self.error is not None:
            raise self.error
        received, self.inbox = self.inbox, []
        return [Received(data, 5, "somebody") for data in received]

    def send(self, data: bytes, client: int = 0) -> None:
        self.sent.append(data)

    def filenos(self) -> list[int]:
        return []

    def close(self) -> None:
        pass


@pytest.mark.parametrize("error", [DriverError("gone"), OSError(), ValueError("a fault")])
def test_a_link_that_breaks_takes_no_other_with_it(error: Exception, capfd: pytest.CaptureFixture[str]) -> None:
    broken, good = Line(), Line()
    broken.error = error
    with BootLinks([broken, good], 1, "generic") as boot:
        assert kinds(*good.sent) == ["HEARTBEAT"]
        good.inbox.append(packed(ARM, COUNT))
        while "COMMAND_ACK" not in kinds(*good.sent):
            assert boot._thread.is_alive()
            time.sleep(TURN_S)
        broken.error = None
        while not broken.sent:
            assert boot._thread.is_alive()
            time.sleep(TURN_S)
        kept = boot.take_unanswered()
    assert [(frame.link, frame.client, kinds(frame.data)) for frame in kept] == [(1, 5, ["MISSION_COUNT"])]
    assert capfd.readouterr().err.count("Traceback") == isinstance(error, ValueError)
