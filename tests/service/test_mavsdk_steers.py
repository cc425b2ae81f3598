"""MAVSDK's offboard and manual control plugins fly the service, over UDP, in real time."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from piloted_world import PilotedWorld

from autopilot.mavlink.api import FlightMode

mavsdk = pytest.importorskip("mavsdk")

from mavsdk.plugins.action import Action  # noqa: E402
from mavsdk.plugins.manual_control import ManualControl  # noqa: E402
from mavsdk.plugins.offboard import (  # noqa: E402
    AccelerationNed,
    Attitude,
    Offboard,
    OffboardError,
    PositionNedYaw,
    VelocityBodyYawspeed,
    VelocityNedYaw,
)


class Loop(threading.Thread):
    """The service between a socket and MAVSDK, never quicker than the clock."""

    def __init__(self, world: PilotedWorld, port: int) -> None:
        super().__init__(daemon=True)
        self.world, self.address, self.ending = world, ("127.0.0.1", port), threading.Event()
        self.texts: list[str] = []

    def run(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.setblocking(False)
            due = time.monotonic()
            while not self.ending.is_set():
                due = max(due + 0.01, time.monotonic())
                time.sleep(max(0.0, due - time.monotonic()))
                received = []
                while True:
                    try:
                        received.append(sock.recv(4096))
                    except (BlockingIOError, ConnectionRefusedError):
                        break
                self.world.heard.clear()
                for frame in self.world.tick(received).mavlink_tx:
                    sock.sendto(frame.data, self.address)
                self.texts += [m.text for m in self.world.heard if m.get_type() == "STATUSTEXT"]

    def until(self, done: Callable[[], bool], seconds: float = 20.0) -> bool:
        """Whether it comes true within so much of the vehicle's time."""
        end_us = self.world.t_us + round(seconds * 1e6)
        while self.world.t_us < end_us and self.is_alive():
            if done():
                return True
            time.sleep(0.02)
        return done()


@pytest.fixture(name="flight")
def flight_fixture() -> Iterator[tuple[Loop, Any]]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    world = PilotedWorld((-1.4, 0.4, 0.5, 0.0))
    world.run(1.5)
    loop = Loop(world, port)
    mavsdk.log_subscribe(lambda *args: True)
    configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
    with mavsdk.Mavsdk(configuration) as sdk:
        sdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        loop.start()
        try:
            system = sdk.first_autopilot(600.0)
            assert system is not None
            yield loop, system
        finally:
            loop.ending.set()
            loop.join()


def test_mavsdk_flies_set_points_and_hears_of_those_that_are_refused(flight: tuple[Loop, Any]) -> None:
    loop, system = flight
    world, commander = loop.world, loop.world.parts.commander
    action, offboard = Action(system), Offboard(system)
    action.arm()
    offboard.set_velocity_ned(VelocityNedYaw(0.15, 0.0, 0.0, 0.0))
    offboard.start()
    north = float(world.x[0])
    assert loop.until(lambda: world.x[0] > north + 0.2) and offboard.is_active()
    offboard.set_position_ned(PositionNedYaw(-0.8, 0.7, 0.6, 90.0))
    assert loop.until(lambda: bool(np.linalg.norm(world.x[:3] - (-0.8, 0.7, 0.6)) < 0.1 and world.x[3] > 1.4))
    offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 20.0))
    assert loop.until(lambda: world.x[7] > 0.25)
    offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.5))
    assert loop.until(lambda: abs(world.x[3]) < 0.2)
    offboard.stop()
    assert loop.until(lambda: commander.mode is FlightMode.HOLD)

    offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    offboard.start()
    offboard.set_acceleration_ned(AccelerationNed(0.1, 0.0, 0.0))
    assert loop.until(lambda: commander.mode is FlightMode.HOLD)
    assert any("Set point refused: no accelerations" in text for text in loop.texts), loop.texts
    assert loop.until(lambda: not offboard.is_active())
    offboard.set_acceleration_ned(AccelerationNed(0.1, 0.0, 0.0))
    loop.until(lambda: False, 0.3)
    with pytest.raises(OffboardError, match="DENIED"):
        offboard.start()
    assert loop.until(lambda: not offboard.is_active())


def test_mavsdk_steers_by_sticks(flight: tuple[Loop, Any]) -> None:
    loop, system = flight
    world, commander = loop.world, loop.world.parts.commander
    action, manual = Action(system), ManualControl(system)
    action.arm()
    stop = threading.Event()
    sticks = [(0.0, 0.0, 0.5, 0.0)]

    def send() -> None:
        while not stop.wait(0.05):
            manual.set_manual_control_input(*sticks[0])

    sender = threading.Thread(target=send, daemon=True)
    sender.start()
    try:
        assert loop.until(lambda: commander.armed and world.parts.server.sticks is not None)
        manual.start_position_control()
        assert commander.mode is FlightMode.POSHOLD
        loop.until(lambda: False, 0.6)
        north, depth = float(world.x[0]), float(world.x[2])
        sticks[0] = (0.8, 0.0, 0.5, 0.0)
        assert loop.until(lambda: world.x[0] > north + 0.3)
        sticks[0] = (0.0, 0.0, 0.0, 0.0)
        assert loop.until(lambda: world.x[2] > depth + 0.1)
        manual.start_altitude_control()
        assert commander.mode is FlightMode.ALT_HOLD
    finally:
        stop.set()
        sender.join()
    assert loop.until(lambda: any("pilot input lost" in text for text in loop.texts))
