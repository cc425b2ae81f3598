"""A mission sent, read back and begun over a link that drops, duplicates and reorders a fifth of its datagrams."""

import random
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import development as mav
from system_harness import RunningService

from autopilot.core.plan import PlanItem, PlanKind
from autopilot.core.plan_wire import item_message
from autopilot.mission.paper import paper_plan

SHARE = 0.2
"""Of the datagrams that are lost, of those that come twice, and of those that come after the next one."""


class BadLink:
    """pymavlink's UDP socket with a bad network between it and the vehicle, both ways."""

    def __init__(self, port: int, seed: int) -> None:
        self._rng = random.Random(seed)
        self._file = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=253, source_component=190, dialect="development"
        )
        self._held: list[Any] = []
        self._inbox: deque[Any] = deque()
        self.bad = True
        self.lost = 0

    def close(self) -> None:
        self._file.close()

    def send(self, message: Any) -> None:
        self._through(message.pack(self._file.mav), self._file.write, self._held)

    def receive(self) -> list[Any]:
        found = []
        while (message := self._file.recv_msg()) is not None:
            found.append(message)
        self._inbox.extend(found)
        out: list[Any] = []
        held: list[Any] = []
        while self._inbox:
            self._through(self._inbox.popleft(), out.append, held)
        return out + held

    def _through(self, thing: Any, deliver: Callable[[Any], object], held: list[Any]) -> None:
        if not self.bad:
            deliver(thing)
            return
        fate = self._rng.random()
        if fate < SHARE:
            self.lost += 1
            return
        if fate < 2 * SHARE and not held:
            held.append(thing)
            return
        deliver(thing)
        if fate < 3 * SHARE:
            deliver(thing)
        while held:
            deliver(held.pop())


class Pilot:
    """The least that a client needs: resend what is not answered."""

    def __init__(self, link: BadLink, service: RunningService) -> None:
        self.link = link
        self.service = service
        self._beat_s = 0.0

    def pump(self) -> list[Any]:
        if time.monotonic() - self._beat_s > 1.0:
            self._beat_s = time.monotonic()
            self.link.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        time.sleep(0.005)
        self.service.keep_waiting(cpu_s=150.0)
        return self.link.receive()

    def wait_for(self, done: Callable[[Any], bool], resend: Callable[[], None], every_s: float = 0.1) -> Any:
        sent_s = -1.0
        while True:
            if time.monotonic() - sent_s > every_s:
                sent_s = time.monotonic()
                resend()
            for message in self.pump():
                if done(message):
                    return message

    def upload(self, kind: PlanKind, items: tuple[PlanItem, ...]) -> None:
        asked: int | None = None

        def send() -> None:
            """COUNT until the vehicle asks; then the item that it asked for last, until it asks on or is content."""
            if asked is None:
                self.link.send(mav.MAVLink_mission_count_message(1, 1, len(items), int(kind)))
            else:
                self.link.send(item_message(items[asked], kind))

        def step(message: Any) -> bool:
            nonlocal asked
            name = message.get_type()
            if name in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and message.mission_type == kind:
                asked = message.seq
                send()
            return bool(name == "MISSION_ACK" and message.mission_type == kind and asked is not None)

        assert self.wait_for(step, send).type == mav.MAV_MISSION_ACCEPTED

    def download(self, kind: PlanKind) -> list[Any]:
        def request_list() -> None:
            self.link.send(mav.MAVLink_mission_request_list_message(1, 1, int(kind)))

        count = self.wait_for(lambda m: m.get_type() == "MISSION_COUNT" and m.mission_type == kind, request_list).count
        items = []
        for seq in range(count):

            def request(seq: int = seq) -> None:
                self.link.send(mav.MAVLink_mission_request_int_message(1, 1, seq, int(kind)))

            items.append(
                self.wait_for(
                    lambda m, seq=seq: m.get_type() == "MISSION_ITEM_INT" and (m.seq, m.mission_type) == (seq, kind),
                    request,
                )
            )
        return items

    def command(self, command: int, param1: float) -> None:
        def send() -> None:
            self.link.send(mav.MAVLink_command_long_message(1, 1, command, 0, param1, 0, 0, 0, 0, 0, 0))

        self.wait_for(lambda m: m.get_type() == "COMMAND_ACK" and (m.command, m.result) == (command, 0), send)


@pytest.mark.parametrize("seed", [1])
def test_mission_over_a_bad_link(service: Callable[..., RunningService], seed: int) -> None:
    vehicle = service()
    link = BadLink(vehicle.port, seed)
    try:
        pilot = Pilot(link, vehicle)
        plan = paper_plan(1)
        pilot.wait_for(lambda m: m.get_type() == "HEARTBEAT", lambda: None)
        for kind in (PlanKind.FENCE, PlanKind.MISSION):
            pilot.upload(kind, plan.items(kind))
            back = pilot.download(kind)
            assert [(m.seq, m.command, m.x, m.y) for m in back] == [
                (i.seq, i.command, i.x, i.y) for i in plan.items(kind)
            ]
        assert link.lost > 10
        link.bad = False
        pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        pilot.command(mav.MAV_CMD_MISSION_START, 0.0)
        while not any(m.get_type() == "MISSION_CURRENT" and (m.mission_state, m.seq) == (3, 1) for m in pilot.pump()):
            pass
    finally:
        link.close()
