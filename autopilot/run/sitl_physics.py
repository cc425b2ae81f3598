"""Physics backend for ArduPilot SITL: serves a scenario's plant over the JSON interface (UDP)."""

import json
import select
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.links import open_link
from autopilot.run.truth_file import opened_truth
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
TRACK_US = 100_000
"""Interval of lines in the truth file."""
MAX_PACKET = 2048


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
    scenario_name: str,
    vehicle_name: str,
    frame: str,
    *,
    host: str,
    port: int,
    pose: Sequence[str],
    camera: CameraPlace | None,
    seed: int,
    duration_s: float | None,
    truth_file: Path | None,
    stop: Callable[[], bool],
    tell: Callable[[str], None],
) -> PhysicsFlight:
    """Answer ArduPilot until ``stop`` or for a simulated duration. ``pose``: link of the tracking system's
    reports; ``camera``: where one has its pictures. ConfigError if a port cannot be opened.
    """
    scenario = with_vehicle(load_scenario(scenario_name), vehicle_name, "--vehicle")
    hull = load_vehicle(vehicle_name)
    check_frame(hull, frame)
    vehicles: list[ArduSubVehicle] = []

    def fresh() -> Callable[[int, tuple[int, ...]], Truth]:
        vehicles.append(ArduSubVehicle(scenario, hull, frame, seed=seed))
        return vehicles[-1].driven

    physics = JsonPhysics(
        fresh, None if scenario.tank is None else scenario.tank.depth_m, hull.depth_sensor.position_frd_m
    )
    track = opened_truth(truth_file)
    trackers = [open_link(text) for text in pose]
    pictures = opened_camera(scenario, hull, seed, camera, tell)
    flight, end_us = PhysicsFlight(), None if duration_s is None else 1e6 * duration_s
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
        next_track_us = 0
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
                    began_s, next_track_us = received_s, 0
                    tell(f"ArduPilot speaks from {peer[0]}:{peer[1]}" if not spoke else "ArduPilot began anew")
                spoke, silent = True, False
                server.sendto(answer, peer)
                if pictures is not None:
                    if physics.restarts > before:
                        pictures.restart()
                    pictures.tilt(vehicles[-1].camera_off_rad)
                    pictures.observe(physics.truth)
                report = vehicles[-1].pose(physics.t_us)
                for link in trackers if report is not None else ():
                    link.recv(physics.t_us)
                    link.send(report or b"")
                start = scenario.vehicle.start_m
                away_m = sum((a - b) ** 2 for a, b in zip(physics.truth.pos_ned_m, start, strict=True)) ** 0.5
                flight.max_distance_m = max(flight.max_distance_m, float(away_m))
                if track is not None and physics.t_us >= next_track_us:
                    next_track_us += TRACK_US
                    row = [1e-6 * physics.t_us, *physics.truth.pos_ned_m.tolist(), *physics.truth.rpy_rad.tolist()]
                    track.write(json.dumps([*row, *vehicles[-1].controller.servos_us]).encode() + b"\n")
        finally:
            for device in (*trackers, *(() if pictures is None else (pictures,))):
                device.close()
            if track is not None:
                track.close()
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
