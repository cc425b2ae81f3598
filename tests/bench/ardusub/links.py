"""A MAVLink connection of pymavlink that is read all the time: what came, and when."""

import threading
import time
from collections.abc import Callable
from typing import Any

from pymavlink import mavutil

Message = Any
GROUND_STATION = 255
"""Whom ArduSub obeys."""
READ_S = 0.05
BEAT_S = 0.5
CONNECTING_S = 60
"""TCP is tried each second."""


class Link:
    """Somebody's connection; HEARTBEAT as a ground station while ``beating``."""

    def __init__(self, address: str, *, component: int = 190) -> None:
        self.wire: Any = mavutil.mavlink_connection(
            address,
            source_system=GROUND_STATION,
            source_component=component,
            dialect="ardupilotmega",
            autoreconnect=True,
            retries=CONNECTING_S,
        )
        self.beating = True
        self._came: list[tuple[float, Message]] = []
        self._arrival = threading.Condition()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self.wire.close()

    def _read(self) -> None:
        beat_s = 0.0
        while not self._ending.is_set():
            now_s = time.monotonic()
            if self.beating and now_s - beat_s > BEAT_S:
                beat_s = now_s
                self.say("heartbeat", 6, 8, 0, 0, 4)
            try:
                message = self.wire.recv_match(blocking=True, timeout=READ_S)
            except (OSError, TypeError):  # between two connections
                continue
            if message is not None and message.get_type() != "BAD_DATA":
                with self._arrival:
                    self._came.append((time.monotonic(), message))
                    self._arrival.notify_all()

    def say(self, name: str, *fields: Any) -> None:
        try:
            getattr(self.wire.mav, f"{name}_send")(*fields)
        except OSError:
            return  # nobody there

    @property
    def mark(self) -> int:
        """Now, among the messages that came."""
        return len(self._came)

    def since(self, mark: int, kind: str) -> list[tuple[float, Message]]:
        return [(t_s, message) for t_s, message in self._came[mark:] if message.get_type() == kind]

    def wait(
        self, kind: str, fits: Callable[[Message], bool], patience_s: float, mark: int | None = None
    ) -> tuple[float, Message]:
        """The first of this kind that fits, and when it came [s]; TimeoutError."""
        begin_s, seen = time.monotonic(), self.mark if mark is None else mark
        with self._arrival:
            while True:
                for t_s, message in self._came[seen:]:
                    if message.get_type() == kind and fits(message):
                        return t_s, message
                seen = len(self._came)
                left_s = patience_s - (time.monotonic() - begin_s)
                if left_s <= 0.0:
                    raise TimeoutError(f"no such {kind} within {patience_s:g} s")
                self._arrival.wait(min(left_s, 1.0))

    def text(self, part: str, patience_s: float = 60.0, mark: int | None = None) -> tuple[float, str]:
        """A STATUSTEXT with this part in it (its first chunk)."""
        try:
            t_s, message = self.wait("STATUSTEXT", lambda m: part in m.text, patience_s, mark)
        except TimeoutError:
            said = [m.text for _, m in self.since(mark or 0, "STATUSTEXT")][-6:]
            raise TimeoutError(f"not told within {patience_s:g} s: {part!r}; last texts {said}") from None
        return t_s, message.text

    def command(self, number: int, *params: float) -> int:
        """MAV_RESULT of a COMMAND_LONG to the autopilot, asked again each second."""
        filled = (*params, *(0.0,) * (7 - len(params)))
        mark = self.mark
        for turn in range(20):
            self.say("command_long", 1, 1, number, turn, *filled)
            try:
                return int(
                    self.wait("COMMAND_ACK", lambda m: m.command == number and m.result != 5, 1.0, mark)[1].result
                )
            except TimeoutError:
                continue
        raise TimeoutError(f"no answer to command {number}")

    def set_parameter(self, name: str, value: float) -> None:
        """PARAM_SET until the value comes back."""
        mark = self.mark
        for _ in range(20):
            self.say("param_set", 1, 1, name.encode(), value, 9)
            try:
                self.wait("PARAM_VALUE", lambda m: m.param_id == name and abs(m.param_value - value) < 1e-4, 1.0, mark)
            except TimeoutError:
                continue
            return
        raise TimeoutError(f"{name} {value:g} is not taken")
