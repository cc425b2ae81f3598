"""What surrounds a simulated vehicle with ArduSub: its water, camera and tracking system, and a file of true poses."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.links import open_link
from autopilot.sitl.ardusub_emulator import check_frame
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.camera_process import CameraPlace, opened_camera
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario import load_scenario, with_vehicle

TRACK_US = 100_000
"""Interval of lines in the truth file."""


class ArduSubWorld:
    """Of one scenario; the vehicle in it may be put there anew."""

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
