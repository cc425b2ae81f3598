"""A service that is starting: heard within a second of CPU time, honest about what it cannot do yet, then itself."""

import select
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import RunningService

from autopilot.mavlink.boot import STARTING
from autopilot.run.children import Child, autopilot_command, free_port

FIRST_HEARTBEAT_CPU_S = 1.0


class Station:
    """A ground station on a socket."""

    def __init__(self, service: RunningService, listens: socket.socket | None = None) -> None:
        self._service = service
        self._codec = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self._codec.robust_parsing = True
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM) if listens is None else listens
        self._address: Any = ("127.0.0.1", service.port)

    def send(self, message: Any) -> None:
        self._socket.sendto(message.pack(self._codec), self._address)

    def hear(self, done: Callable[[Any], bool], resend: Any = None) -> Any:
        """The first message of that kind; ``resend`` goes out again and again until it comes."""
        resend = resend or mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        while True:
            self._service.keep_waiting()
            self.send(resend)
            while select.select([self._socket], [], [], 0.02)[0]:
                for message in self._codec.parse_buffer(self._socket.recv(4096)) or ():
                    if done(message):
                        return message


def _heartbeat(*states: int) -> Callable[[Any], bool]:
    return lambda m: m.get_type() == "HEARTBEAT" and (not states or m.system_status in states)


@pytest.fixture
def silent_ear() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        yield ear


def test_a_station_that_speaks_is_answered_within_a_second_of_cpu_time(service: Callable[..., RunningService]) -> None:
    running = service("--param", "FENCE_REQUIRED=0")
    station = Station(running)
    first = station.hear(_heartbeat())
    cpu_s = running.child.cpu_s()
    assert cpu_s is not None
    assert cpu_s < FIRST_HEARTBEAT_CPU_S
    assert first.system_status == mav.MAV_STATE_BOOT
    assert (first.type, first.autopilot, first.get_srcSystem()) == (mav.MAV_TYPE_SUBMARINE, 12, 1)
    assert not first.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED
    arm = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    text = station.hear(lambda m: m.get_type() == "STATUSTEXT", arm)
    assert text.text == STARTING
    assert len(STARTING) <= 50
    refused = station.hear(lambda m: m.get_type() == "COMMAND_ACK", arm)
    assert refused.result == mav.MAV_RESULT_TEMPORARILY_REJECTED
    station.hear(_heartbeat(mav.MAV_STATE_STANDBY))
    stamp = station.hear(lambda m: m.get_type() == "ATTITUDE")
    assert stamp.time_boot_ms < 60_000, "the vehicle's time begins when all is loaded"
    station.hear(lambda m: m.get_type() == "COMMAND_ACK" and m.result == mav.MAV_RESULT_ACCEPTED, arm)


def test_a_station_that_only_listens_hears_it_as_early(
    service: Callable[..., RunningService], silent_ear: socket.socket
) -> None:
    running = service("--connect", f"udpout:127.0.0.1:{silent_ear.getsockname()[1]}")
    while not select.select([silent_ear], [], [], 0.1)[0]:
        running.keep_waiting()
    cpu_s = running.child.cpu_s()
    assert cpu_s is not None
    assert cpu_s < FIRST_HEARTBEAT_CPU_S
    codec = mav.MAVLink(None)
    (message,) = codec.parse_buffer(silent_ear.recv(4096))
    assert (message.get_type(), message.system_status) == ("HEARTBEAT", mav.MAV_STATE_BOOT)


@pytest.mark.parametrize(
    "argument",
    [("--param", "SPEED=1"), ("--plan", "nothing.plan"), ("--sensors", "camera"), ("--instance", "99")],
)
def test_what_cannot_start_lets_go_of_its_port(argument: tuple[str, str]) -> None:
    """An error before or after the links are open."""
    port = free_port()
    scenario = "open-water" if argument == ("--sensors", "camera") else "paper-tank"
    broken = () if argument[0] != "--instance" else ("--param", "SYSID_THISMAV=200")
    child = Child(autopilot_command("sitl", scenario, *argument, *broken, "--connect", f"udpin:127.0.0.1:{port}"))
    assert child.process.wait() in (1, 2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", port))


def test_a_plan_that_is_announced_while_the_service_starts_is_asked_for(service: Callable[..., RunningService]) -> None:
    """Once, by a client that does not repeat itself."""
    running = service()
    station = Station(running)
    assert station.hear(_heartbeat()).system_status == mav.MAV_STATE_BOOT
    station.send(mav.MAVLink_mission_count_message(1, 1, 3, 0))
    request = station.hear(lambda m: m.get_type() in ("MISSION_REQUEST_INT", "MISSION_ACK"))
    assert (request.get_type(), request.seq, request.mission_type) == ("MISSION_REQUEST_INT", 0, 0)
