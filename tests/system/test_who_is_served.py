"""A crowd that is silent, sends junk, does not read or has gone, on real sockets: who wants something is served."""

import contextlib
import random
import socket
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import Harbour, hear_all

from autopilot.bench.live_service import Station
from autopilot.run.children import LOCAL, free_port

CROWD = 26
"""Clients that want nothing: more than there are places on either port."""
SECOND = 100
"""Ticks."""
SERVED = 30 * SECOND
"""So long a newcomer waits at most behind such a crowd (each of them has 1.5 s, or 5 s if it has said something)."""


class Vehicle(Harbour):
    """The service in simulated time on a UDP and a TCP port."""

    def __init__(self, session: OpenSession) -> None:
        self.ports = {"udp": free_port(), "tcp": free_port(socket.SOCK_STREAM)}
        links = (f"udpin:{LOCAL}:{self.ports['udp']}", f"tcpin:{LOCAL}:{self.ports['tcp']}")
        super().__init__(session("open-water", sensors="pose", connections=links))

    def connect(self, kind: str) -> socket.socket:
        """A client's socket, which waits for nothing."""
        if kind == "udp":
            end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            end.connect((LOCAL, self.ports[kind]))
        else:
            end = socket.create_connection((LOCAL, self.ports[kind]))
        end.setblocking(False)
        return end


@pytest.fixture(name="vehicle")
def vehicle_fixture(session: OpenSession) -> Vehicle:
    return Vehicle(session)


class Bore:
    def __init__(self, vehicle: Vehicle, kind: str, sort: str, draw: random.Random) -> None:
        self.socket, self._sort, self._draw = vehicle.connect(kind), sort, draw
        if sort == "silent" and kind == "udp":
            self._say(b"\n")  # a UDP client that has sent nothing is none
        if sort == "gone":
            self._say(bytes(_heartbeat().pack(mav.MAVLink(None, srcSystem=draw.randint(2, 250), srcComponent=1))))

    def act(self) -> None:
        if self._sort == "junk" and self._draw.random() < 0.1:
            self._say(self._draw.choice((b"\xfd", b"\xfe\x09")) * self._draw.randint(1, 40))

    def _say(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self.socket.send(data)


def _heartbeat() -> Any:
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


def _until_served(vehicle: Vehicle, station: Station, meanwhile: Callable[[], None]) -> int:
    """Ticks until a station that says HEARTBEAT and PING every second has an answer."""
    for ticks in range(SERVED):
        if ticks % SECOND == 0:
            station.beat()
            station.send(mav.MAVLink_ping_message(0, 1, 0, 0))
        meanwhile()
        vehicle.tick()
        if any(message.get_type() == "PING" for message in hear_all(station)):
            return ticks
    raise AssertionError(f"not served in {SERVED / SECOND:g} s")


@pytest.mark.parametrize("kind", ["udp", "tcp"])
@pytest.mark.parametrize("sorts", [("silent",), ("gone",), ("silent", "junk", "gone")])
def test_a_crowd_locks_nobody_out(vehicle: Vehicle, kind: str, sorts: tuple[str, ...]) -> None:
    """A station in control stays, newcomers come in behind the crowd and before it, and it is said."""
    draw = random.Random(f"{kind} {sorts}")
    operator = Station(vehicle.connect(kind), sysid=255)
    crowd: list[Bore] = []

    def all_act() -> None:
        for bore in crowd:
            bore.act()
        if vehicle.ticks % SECOND == 0:
            operator.beat()
            early.beat()

    early = Station(vehicle.connect(kind), sysid=254)
    _until_served(vehicle, operator, all_act)
    operator.send(mav.MAVLink_command_long_message(1, 1, 32100, 0, 1, 0, 0, 0, 0, 0, 0))
    for _ in range(CROWD):
        crowd.append(Bore(vehicle, kind, draw.choice(sorts), draw))
        for _ in range(draw.randint(0, 3)):
            all_act()
            vehicle.tick()
    late = Station(vehicle.connect(kind), sysid=253)
    _until_served(vehicle, late, all_act)
    _until_served(vehicle, early, all_act)
    answers = 0
    for n in range(5 * SECOND):
        all_act()
        if n % 10 == 0:
            operator.send(mav.MAVLink_ping_message(0, n, 0, 0))
        vehicle.tick()
        answers += sum(message.get_type() == "PING" for message in hear_all(operator))
    assert answers >= 49, "who is in control has been served all the time"
    said = [text for text in operator.texts if "place" in text or "turned away" in text]
    assert 1 <= len(said) <= vehicle.ticks / (5 * SECOND) + 1, said
    for bore in crowd:
        bore.socket.close()
    for station in (operator, early, late):
        station.close()
