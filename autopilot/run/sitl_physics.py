"""A scenario's plant under ArduPilot's simulation (JSON interface, UDP), or with an emulated flight controller, in real
time and on real links, for ``autopilot run``."""

import select
import socket
import time
from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.drivers.links import open_link
from autopilot.run.clocks import make_clock
from autopilot.run.sitl_ardusub_world import TRACK_US, ArduSubWorld
from autopilot.sitl.ardupilot_json import JsonPhysics
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Scenario

LOOK_S = 0.2
"""Interval at which an idle server checks whether to stop."""
SILENT_S = 5.0
"""Silence of ArduPilot after which a hint is printed."""
MAX_PACKET = 2048
STEP_US = 5_000
"""Its main loop."""


class PhysicsFlight(msgspec.Struct, kw_only=True):
    """Result: vehicle state and statistics of the interface."""

    seconds: float = 0.0
    """Simulated, since ArduPilot started."""
    frames: int = 0
    repeated: int = 0
    missed: int = 0
    restarts: int = 0
    refused: int = 0
    rate_hz: float = 0.0
    """Frames per second of the wall clock."""
    contacts: int = 0
    max_penetration_m: float = 0.0
    energy_j: float = 0.0
    max_distance_m: float = 0.0
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)


def home_of(scenario: Scenario) -> str:
    """The scenario's origin as ArduPilot's ``--home`` has it; heading is the simulation's."""
    origin = scenario.origin
    return f"{origin.lat_deg:.7f},{origin.lon_deg:.7f},{origin.alt_m:g},0"


def serve_physics(
    listen: tuple[str, int],
    *,
    duration: float | None,
    stop: Callable[[], bool],
    tell: Callable[[str], None],
    **world: Any,
) -> PhysicsFlight:
    """Answer ArduPilot until ``stop`` or for a simulated duration [s]. ``listen``: host and port; ``world``: arguments
    of :class:`.ArduSubWorld`. ConfigError if a port cannot be opened.
    """
    around = ArduSubWorld(tell=tell, **world)
    scenario, (host, port) = around.scenario, listen
    vehicles: list[ArduSubVehicle] = []

    def fresh() -> Callable[[int, tuple[int, ...]], Truth]:
        vehicles.append(around.new_vehicle())
        return vehicles[-1].driven

    physics = JsonPhysics(
        fresh, None if scenario.tank is None else scenario.tank.depth_m, around.hull.depth_sensor.position_frd_m
    )
    flight, end_us = PhysicsFlight(), None if duration is None else 1e6 * duration
    received_s = began_s = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        try:
            server.bind((host, port))
        except OSError as error:
            raise ConfigError(
                f"--listen {host}:{port}: cannot listen there ({error.strerror}); choose another"
            ) from error
        tell(f"{scenario.scenario.name}: waiting for ArduPilot on UDP {host}:{server.getsockname()[1]}")
        spoke = silent = False
        try:
            while not stop() and (end_us is None or physics.t_us < end_us):
                if not select.select((server,), (), (), LOOK_S)[0]:
                    if spoke and not silent and time.monotonic() - received_s > SILENT_S:
                        silent = True
                        tell("ArduPilot says nothing any more")
                    continue
                try:
                    data, peer = server.recvfrom(MAX_PACKET)
                except ConnectionError:
                    continue  # the previous answer was lost
                received_s = time.monotonic()
                before = physics.restarts
                answer = physics.answer(data)
                if answer is None or physics.truth is None:
                    continue
                if not spoke or physics.restarts > before:
                    began_s = received_s
                    if physics.restarts > before:
                        around.restart()
                    tell(f"ArduPilot speaks from {peer[0]}:{peer[1]}" if not spoke else "ArduPilot began anew")
                spoke, silent = True, False
                server.sendto(answer, peer)
                around.observe(physics.t_us, vehicles[-1], physics.truth)
        finally:
            around.close()
            flight.max_distance_m = around.max_distance_m
    return _account(flight, physics, time.monotonic() - began_s)


def _account(flight: PhysicsFlight, physics: JsonPhysics, wall_s: float) -> PhysicsFlight:
    flight.seconds, flight.frames, flight.repeated = 1e-6 * physics.t_us, physics.frames, physics.repeated
    flight.missed, flight.restarts, flight.refused = physics.missed, physics.restarts, physics.refused
    flight.rate_hz = physics.frames / max(wall_s, 1e-9)
    truth = physics.truth
    if truth is not None:
        flight.contacts, flight.max_penetration_m = truth.contact_count, truth.max_penetration_m
        flight.energy_j = truth.energy_used_j
        north, east, down = truth.pos_ned_m.tolist()
        roll, pitch, yaw = truth.rpy_rad.tolist()
        flight.position_m, flight.rpy_rad = (north, east, down), (roll, pitch, yaw)
    return flight


class EmulatedFlight(msgspec.Struct, kw_only=True):
    """Ground truth of the vehicle at the end."""

    seconds: float = 0.0
    late_steps: int = 0
    contacts: int = 0
    max_penetration_m: float = 0.0
    energy_j: float = 0.0
    max_distance_m: float = 0.0
    """Farthest from the start that it has been."""


def emulate(links: Sequence[str], *, duration: float | None, stop: Callable[[], bool], **world: Any) -> EmulatedFlight:
    """Run until ``stop`` or for a duration [s]. ``links``: of the flight controller; ``world``: arguments of
    :class:`.ArduSubWorld`."""
    around = ArduSubWorld(**world, first_us=TRACK_US)
    vehicle = around.new_vehicle()
    ends = [open_link(text) for text in links]
    clock, flight, t_us = make_clock(1.0), EmulatedFlight(), 0
    try:
        while not stop() and (duration is None or t_us < 1e6 * duration):
            t_us += STEP_US
            flight.late_steps += clock.wait_until(t_us) - t_us > STEP_US
            for index, link in enumerate(ends):
                for received in link.recv(t_us):
                    vehicle.controller.receive(t_us, received.data, index)
            for data in vehicle.advance(t_us):
                for link in ends:
                    link.send(data)
            around.observe(t_us, vehicle, vehicle.truth)
    finally:
        truth = vehicle.truth
        flight.seconds, flight.contacts = 1e-6 * t_us, truth.contact_count
        flight.max_penetration_m, flight.energy_j = truth.max_penetration_m, truth.energy_used_j
        flight.max_distance_m = around.max_distance_m
        around.close()
        for link in ends:
            link.close()
    return flight
