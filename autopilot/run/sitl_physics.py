"""A scenario's plant under ArduPilot's simulation (JSON interface, UDP), or with an emulated flight controller, in real
time and on real links, for ``autopilot run``."""

import select
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.links import open_link
from autopilot.run.clocks import make_clock
from autopilot.sitl.ardupilot_json import JsonPhysics
from autopilot.sitl.ardusub_emulator import check_frame
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.camera_process import CameraPlace, opened_camera
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario import load_scenario, with_vehicle
from autopilot.sitl.scenario_tables import Scenario

LOOK_S = 0.2
"""Interval at which an idle server checks whether to stop."""
SILENT_S = 5.0
"""Silence of ArduPilot after which a hint is printed."""
MAX_PACKET = 2048
STEP_US = 5_000
"""Its main loop."""
TRACK_US = 100_000
"""Interval of lines in the truth file."""


class ArduSubWorld:
    """Round a vehicle with ArduSub in one scenario: water, camera, tracking system, a file of true poses."""

    def __init__(
        self,
        scenario: str,
        vehicle: str,
        frame: str,
        *,
        seed: int,
        camera: CameraPlace | None,
        pose: Sequence[str],
        truth: Path | None,
        tell: Callable[[str], None],
        first_us: int = 0,
    ) -> None:
        """``camera``: where one has its pictures; ``pose``: links of the tracking system's reports; ``truth``: file of
        true poses, a JSON line each, from ``first_us`` on. ConfigError if one of them cannot be had."""
        self.scenario = with_vehicle(load_scenario(scenario), vehicle, "--vehicle")
        self.hull = load_vehicle(vehicle)
        check_frame(self.hull, frame)
        self._frame, self._seed = frame, seed
        self._track = _opened(truth)
        self._next_us = first_us
        self._pictures = opened_camera(self.scenario, self.hull, seed, camera, tell)
        self._trackers = [open_link(text) for text in pose]
        self.max_distance_m = 0.0
        """Farthest from the start that a vehicle has been."""

    def new_vehicle(self) -> ArduSubVehicle:
        return ArduSubVehicle(self.scenario, self.hull, self._frame, seed=self._seed)

    def observe(self, t_us: int, vehicle: ArduSubVehicle, truth: Truth) -> None:
        """Show the vehicle as it is now to camera, tracking system and file."""
        if self._pictures is not None:
            self._pictures.tilt(vehicle.camera_off_rad)
            self._pictures.observe(truth)
        report = vehicle.pose(t_us)
        for link in self._trackers if report is not None else ():
            link.recv(t_us)
            link.send(report or b"")
        place = truth.pos_ned_m.tolist()
        away = sum((a - b) ** 2 for a, b in zip(place, self.scenario.vehicle.start_m, strict=True)) ** 0.5
        self.max_distance_m = max(self.max_distance_m, float(away))
        if self._track is not None and t_us >= self._next_us:
            self._next_us += TRACK_US
            row = [1e-6 * t_us, *place, *truth.rpy_rad.tolist(), *vehicle.controller.servos_us]
            self._track.write(msgspec.json.encode(row) + b"\n")

    def restart(self) -> None:
        """The time begins anew."""
        self._next_us = 0
        if self._pictures is not None:
            self._pictures.restart()

    def close(self) -> None:
        for device in (*self._trackers, *(one for one in (self._pictures, self._track) if one is not None)):
            device.close()


def _opened(path: Path | None) -> IO[bytes] | None:
    try:
        return None if path is None else path.open("wb")
    except OSError as error:
        raise ConfigError(f"--truth {path}: cannot be written ({error.strerror}); check folder and rights") from error


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
