"""The whole service at a serial line of 57,600 baud, in its own time: commands are answered whatever is asked for."""

import os
import pty
import tty
from itertools import pairwise
from typing import Any

from system_harness import OpenSession
from wire_client import Harbour

from autopilot.mavlink.dialect import mav

BYTES_PER_TICK = 57.6
TICKS_AT_MOST = 30
"""300 ms: a command, its way, what stands before the answer in the line, the answer."""


class Line:
    """The far end of a pseudo terminal, which takes no more a tick than the line carries."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._may = descriptor, 0.0
        self.codec: Any = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self.codec.robust_parsing = True
        self.carried = 0

    def take(self) -> list[Any]:
        self._may = min(self._may + BYTES_PER_TICK, 300.0)
        try:
            data = os.read(self._descriptor, int(self._may))
        except BlockingIOError:
            return []
        self._may -= len(data)
        self.carried += len(data)
        return self.codec.parse_buffer(data) or []

    def send(self, message: Any) -> None:
        """A few bytes; the way up is never full here."""
        os.write(self._descriptor, message.pack(self.codec))
        self.codec.seq = (self.codec.seq + 1) & 0xFF


def test_commands_are_answered_though_everything_is_asked_for_at_once(session: OpenSession) -> None:
    """Streams at 50 Hz, the list of parameters, a plan's download, and commands in between."""
    far, near = pty.openpty()
    tty.setraw(far)
    os.set_blocking(far, False)
    harbour = Harbour(session(sensors="pose", speed=1.0, connections=(f"{os.ttyname(near)}:57600",)))
    line, beats, waits, values = Line(far), list[int](), list[int](), set[int]()
    try:
        asked: int | None = None
        for tick in range(1, 1200):
            harbour.tick()
            for message in line.take():
                if message.get_type() == "HEARTBEAT":
                    beats.append(tick)
                elif message.get_type() == "PARAM_VALUE":
                    values.add(message.param_index)
                elif message.get_type() == "COMMAND_ACK" and message.command == 401 and asked is not None:
                    waits.append(tick - asked)
                    asked = None
            if tick % 100 == 1:
                line.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
            if tick == 50:
                line.send(mav.MAVLink_request_data_stream_message(1, 1, 0, 50, 1))
                line.send(mav.MAVLink_param_request_list_message(1, 1))
                line.send(mav.MAVLink_mission_request_list_message(1, 1, 1))
            if tick > 100 and tick % 37 == 0 and asked is None:
                line.send(mav.MAVLink_command_long_message(1, 1, 401, 0, *[0.0] * 7))
                asked = tick
            assert asked is None or tick - asked <= TICKS_AT_MOST
    finally:
        harbour.session.runtime.close()
        os.close(far)
        os.close(near)
    assert len(waits) >= 20 and len(values) > 50
    assert max(after - before for before, after in pairwise(beats)) <= 125
    assert line.carried > 0.6 * 12 * 5760, "the line is used"
