"""MAVSDK's offboard and manual control plugins fly the service, over UDP, in real time."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from mavsdk.plugins.action import Action
from mavsdk.plugins.manual_control import ManualControl
from mavsdk.plugins.offboard import (
    AccelerationNed,
    Attitude,
    Offboard,
    OffboardError,
    PositionNedYaw,
    VelocityBodyYawspeed,
    VelocityNedYaw,
)
from mavsdk_link import found
from piloted_world import PilotedWorld

from autopilot.mavlink.api import FlightMode


class Flight:
    """A vehicle in the water, and what it has said."""

    def __init__(self, world: PilotedWorld) -> None:
        self.world = world
        self.texts: list[str] = []
        self.loop: threading.Thread | None = None
        """Who steps it."""

    def step(self, received: Sequence[bytes]) -> list[bytes]:
        """A tick."""
        self.world.inbox.clear()
        sent = [frame.data for frame in self.world.tick(list(received)).mavlink_tx]
        self.texts += [m.text for m in self.world.inbox if m.get_type() == "STATUSTEXT"]
        return sent

    def until(self, done: Callable[[], bool], seconds: float = 20.0) -> bool:
        """Whether it comes true within so much of the vehicle's time."""
        end_us = self.world.t_us + round(seconds * 1e6)
        while self.world.t_us < end_us and self.loop is not None and self.loop.is_alive():
            if done():
                return True
            time.sleep(0.02)
        return done()


@pytest.fixture(name="flight")
def flight_fixture() -> Iterator[tuple[Flight, Any]]:
    world = PilotedWorld((-1.4, 0.4, 0.5, 0.0))
    world.run(1.5)
    flight = Flight(world)
    with found(flight.step) as (system, flight.loop):
        yield flight, system


def test_mavsdk_flies_set_points_and_hears_of_those_that_are_refused(flight: tuple[Flight, Any]) -> None:
    vehicle, system = flight
    world, commander = vehicle.world, vehicle.world.parts.commander
    action, offboard = Action(system), Offboard(system)
    action.arm()
    offboard.set_velocity_ned(VelocityNedYaw(0.15, 0.0, 0.0, 0.0))
    offboard.start()
    north = float(world.x[0])
    assert vehicle.until(lambda: world.x[0] > north + 0.2) and offboard.is_active()
    offboard.set_position_ned(PositionNedYaw(-0.8, 0.7, 0.6, 90.0))
    assert vehicle.until(lambda: bool(np.linalg.norm(world.x[:3] - (-0.8, 0.7, 0.6)) < 0.1 and world.x[3] > 1.4))
    offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 20.0))
    assert vehicle.until(lambda: world.x[7] > 0.25)
    offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.5))
    assert vehicle.until(lambda: abs(world.x[3]) < 0.2)
    offboard.stop()
    assert vehicle.until(lambda: commander.mode is FlightMode.HOLD)

    offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    offboard.start()
    offboard.set_acceleration_ned(AccelerationNed(0.1, 0.0, 0.0))
    refused = "Set point refused: no accelerations"
    assert vehicle.until(lambda: any(refused in text for text in vehicle.texts)), vehicle.texts
    assert vehicle.until(lambda: commander.mode is FlightMode.HOLD)
    assert vehicle.until(lambda: not offboard.is_active())
    offboard.set_acceleration_ned(AccelerationNed(0.1, 0.0, 0.0))
    vehicle.until(lambda: False, 0.3)
    with pytest.raises(OffboardError, match="DENIED"):
        offboard.start()
    assert vehicle.until(lambda: not offboard.is_active())


def test_mavsdk_steers_by_sticks(flight: tuple[Flight, Any]) -> None:
    vehicle, system = flight
    world, commander = vehicle.world, vehicle.world.parts.commander
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
        assert vehicle.until(lambda: commander.armed and world.parts.server.pilot.sticks is not None)
        manual.start_position_control()
        assert commander.mode is FlightMode.POSHOLD
        vehicle.until(lambda: False, 0.6)
        north, depth = float(world.x[0]), float(world.x[2])
        sticks[0] = (0.8, 0.0, 0.5, 0.0)
        assert vehicle.until(lambda: world.x[0] > north + 0.3)
        sticks[0] = (0.0, 0.0, 0.0, 0.0)
        assert vehicle.until(lambda: world.x[2] > depth + 0.1)
        manual.start_altitude_control()
        assert commander.mode is FlightMode.ALT_HOLD
    finally:
        stop.set()
        sender.join()
    assert vehicle.until(lambda: any("pilot input lost" in text for text in vehicle.texts))
