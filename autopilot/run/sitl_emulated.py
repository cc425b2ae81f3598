"""Emulated flight controller with a simulated vehicle, in real time and on real links, for ``autopilot run``."""

from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.links import open_link
from autopilot.run.clocks import make_clock
from autopilot.run.truth_file import opened_truth
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.camera_process import CameraPlace, opened_camera
from autopilot.sitl.scenario import load_scenario, with_vehicle

STEP_US = 5_000
"""Its main loop."""


class EmulatedFlight(msgspec.Struct, kw_only=True):
    """Ground truth of the vehicle at the end."""

    seconds: float = 0.0
    late_steps: int = 0
    contacts: int = 0
    max_penetration_m: float = 0.0
    energy_j: float = 0.0
    max_distance_m: float = 0.0
    """Farthest from the start that it has been."""


def emulate(
    scenario_name: str,
    vehicle_name: str,
    frame: str,
    *,
    links: Sequence[str],
    pose: Sequence[str],
    camera: CameraPlace | None,
    seed: int,
    duration_s: float | None,
    truth_file: Path | None,
    stop: Callable[[], bool],
    tell: Callable[[str], None],
) -> EmulatedFlight:
    """Run until ``stop``. ``links``: of the flight controller; ``pose``: of the tracking system's reports; ``camera``:
    where one has its pictures.
    """
    scenario = with_vehicle(load_scenario(scenario_name), vehicle_name, "--vehicle")
    hull = load_vehicle(vehicle_name)
    vehicle = ArduSubVehicle(scenario, hull, frame, seed=seed)
    track = opened_truth(truth_file)
    pictures = opened_camera(scenario, hull, seed, camera, tell)
    ends = [open_link(text) for text in links]
    trackers = [open_link(text) for text in pose]
    clock, flight, t_us = make_clock(1.0), EmulatedFlight(), 0
    start = vehicle.truth.pos_ned_m.copy()
    encoder = msgspec.json.Encoder()
    try:
        while not stop() and (duration_s is None or t_us < 1e6 * duration_s):
            t_us += STEP_US
            flight.late_steps += clock.wait_until(t_us) - t_us > STEP_US
            for index, link in enumerate(ends):
                for received in link.recv(t_us):
                    vehicle.controller.receive(t_us, received.data, index)
            for data in vehicle.advance(t_us):
                for link in ends:
                    link.send(data)
            report = vehicle.pose(t_us)
            for link in trackers if report is not None else ():
                link.recv(t_us)
                link.send(report or b"")
            truth = vehicle.truth
            if pictures is not None:
                pictures.tilt(vehicle.camera_off_rad)
                pictures.observe(truth)
            away = float(((truth.pos_ned_m - start) ** 2).sum()) ** 0.5
            flight.max_distance_m = max(flight.max_distance_m, away)
            if track is not None and t_us % 100_000 == 0:
                row = [1e-6 * t_us, *truth.pos_ned_m.tolist(), *truth.rpy_rad.tolist(), *vehicle.controller.servos_us]
                track.write(encoder.encode(row) + b"\n")
    finally:
        truth = vehicle.truth
        flight.seconds, flight.contacts = 1e-6 * t_us, truth.contact_count
        flight.max_penetration_m, flight.energy_j = truth.max_penetration_m, truth.energy_used_j
        for device in (*ends, *trackers, *(() if pictures is None else (pictures,))):
            device.close()
        if track is not None:
            track.close()
    return flight
