"""The simulated camera as a process of its own: what it serves, how it begins and ends."""

import contextlib
import json
import math
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import msgspec
import numpy as np
import psutil
import pytest
from click.testing import CliRunner

from autopilot.cli.emulate import emulate, physics
from autopilot.core.errors import ConfigError
from autopilot.core.marker_files import load_marker_map
from autopilot.core.samples import CameraFrame
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.drivers.drivers_tuning import FRAMES
from autopilot.drivers.opencv_camera import OpenCvCamera, OpenCvCameraOptions
from autopilot.drivers.retry import SteadySensor
from autopilot.run.children import autopilot_command, free_port
from autopilot.run.sitl_physics import EmulatedFlight
from autopilot.sitl.ardusub_vehicle import ArduSubVehicle
from autopilot.sitl.camera_feed import simulated_camera
from autopilot.sitl.camera_process import CameraProcess, RtpSender, _moved
from autopilot.sitl.floor import given_markers
from autopilot.sitl.scenario import load_scenario, with_vehicle

SCENARIO = with_vehicle(load_scenario("paper-tank"), "bluerov2", "test")
VEHICLE = load_vehicle("bluerov2")
STREAM_SIGMA_S = 1e-6 * FRAMES.stream_sigma_us


class Watched:
    """A vehicle at rest and its camera, over the time that the machine has."""

    def __init__(self, camera: CameraProcess, vehicle: Vehicle = VEHICLE) -> None:
        self.camera = camera
        self.world = ArduSubVehicle(SCENARIO, vehicle, "vectored", seed=1)
        self.frames: list[CameraFrame] = []

    def until(self, look: Callable[[], bool]) -> None:
        begin_s, t_us = time.monotonic(), 0
        options = OpenCvCameraOptions(source=self.camera.url, latency_s=self.camera.latency_s)
        driver = SteadySensor(OpenCvCamera(VEHICLE, options), "Camera")  # opens beside: it waits for a picture
        with contextlib.closing(driver):
            for _ in range(3000):
                t_us = max(t_us + 5_000, round(1e6 * (time.monotonic() - begin_s)))
                self.world.advance(t_us)
                self.camera.tilt(self.world.camera_off_rad)
                self.camera.observe(self.world.truth)
                self.frames += driver.poll(round(1e6 * (time.monotonic() - begin_s)))  # however long the world took
                if look():
                    return
                time.sleep(0.005)
        raise AssertionError("it does not happen")

    def likeness(self, off_rad: float = 0.0) -> float:
        """Correlation of the last picture with one rendered here: compression, caustics of another time, and some
        millimetres of drift are between them.
        """
        with simulated_camera(SCENARIO, VEHICLE, 1) as feed:
            feed.tilt(off_rad)
            feed.observe(self.world.truth)
            while not (rendered := feed.poll(self.world.truth.t_us + 10_000_000)):
                feed.observe(self.world.truth)  # one was lost
        seen, expected = self.frames[-1].image_bgr.astype(float), rendered[0].image_bgr.astype(float)
        assert seen.shape == expected.shape and expected.std() > 20.0
        return float(np.corrcoef(seen.ravel(), expected.ravel())[0, 1])


@pytest.fixture
def watched() -> Iterator[Watched]:
    with CameraProcess(SCENARIO, VEHICLE, 1) as camera:
        yield Watched(camera)


def test_it_serves_what_the_vehicle_sees_and_begins_anew(watched: Watched) -> None:
    watched.until(lambda: len(watched.frames) >= 5)
    assert watched.likeness() > 0.8
    watched.camera.restart()
    again = Watched(watched.camera)
    again.until(lambda: len(again.frames) >= 2)


def test_a_camera_that_tilts_looks_where_it_is_turned_to() -> None:
    tilt = VEHICLE.tilt
    assert tilt is not None
    payload = tuple(msgspec.structs.replace(one, camera_deg=0.0) if one is tilt else one for one in VEHICLE.payload)
    vehicle = msgspec.structs.replace(VEHICLE, payload=payload)
    with CameraProcess(SCENARIO, vehicle, 1) as camera:
        watched = Watched(camera, vehicle)
        watched.world.controller.extras.tilt_deg = -20.0
        watched.until(lambda: bool(watched.frames) and watched.frames[-1].t_us > 1_500_000)
    assert watched.likeness(math.radians(-20.0)) > 0.8 > 0.5 > watched.likeness()


def test_it_sends_what_a_vehicles_own_camera_sends() -> None:
    """H.264 over RTP: in time, stamped by the sender."""
    with CameraProcess(SCENARIO, VEHICLE, 1, port=free_port(), rtp=True) as camera:
        watched = Watched(camera)
        watched.until(lambda: sum(frame.stamp_sigma_s == STREAM_SIGMA_S for frame in watched.frames) >= 20)
        assert camera.url.startswith("rtp://127.0.0.1:")
    frames = watched.frames
    assert frames[-1].image_bgr.shape == (480, 640, 3) and frames[-1].image_bgr.std() > 20.0
    assert frames[0].stamp_sigma_s > STREAM_SIGMA_S
    stamps_us = np.array([frame.t_us for frame in frames if frame.stamp_sigma_s == STREAM_SIGMA_S])
    steps = np.diff(stamps_us) * VEHICLE.eye.rate_hz * 1e-6
    off_beat = int((np.abs(steps - np.round(steps)) > 0.2).sum())
    assert off_beat <= 1 + len(steps) // FRAMES.again, "on the camera's beat but where the offset is estimated anew"


def test_h264_without_its_library_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ConfigError, match=r"underwater-autopilot\[rtp\]"):
        RtpSender("127.0.0.1", free_port(), 30.0).open()


def test_a_place_that_is_taken_is_told_and_nothing_is_left_behind() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        before = set(psutil.Process().children())
        with pytest.raises(ConfigError, match=f"127.0.0.1:{port}: cannot listen there .*choose another"):
            CameraProcess(SCENARIO, VEHICLE, 1, port=port).open()
        assert set(psutil.Process().children()) == before


def test_one_that_has_ended_is_told(watched: Watched) -> None:
    assert watched.camera._child is not None
    watched.camera._child.kill()
    with pytest.raises(ConfigError, match="has ended"):
        watched.until(lambda: False)


def test_a_scenario_without_a_floor_has_no_camera() -> None:
    with pytest.raises(ConfigError, match=r"no \[tank\]"):
        CameraProcess(load_scenario("open-water"), VEHICLE, 1)


def test_an_exposure_between_two_steps_is_where_the_vehicle_was() -> None:
    world = ArduSubVehicle(SCENARIO, VEHICLE, "vectored", seed=1)
    world.controller.servos_us = (1600, 1650, 1400, 1400, 1600, 1600)
    truths = [world.driven(t_us, world.controller.servos_us) for t_us in (3_000_000, 3_003_000, 3_005_000)]
    guessed = _moved(truths[2], truths[1].t_us)
    assert np.abs(truths[2].pos_ned_m - truths[1].pos_ned_m).max() > 2e-4
    assert np.abs(guessed.pos_ned_m - truths[1].pos_ned_m).max() < 1e-5
    assert np.abs(guessed.rpy_rad - truths[1].rpy_rad).max() < 1e-4


def test_an_emulated_vehicle_has_a_camera(tmp_path: Path) -> None:
    link = f"udpout:127.0.0.1:{free_port()}"
    places = ("--link", link, "--pose", link, "--camera", "127.0.0.1:0")
    command = autopilot_command("emulate", "paper-tank", *places)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None and process.stdout is not None
        told = tomllib.loads("".join(process.stderr.readline() for _ in range(4)))["devices"]["camera"]
        assert told.pop("driver") == "opencv"
        with OpenCvCamera(VEHICLE, OpenCvCameraOptions(**told)) as camera:
            for tick in range(3000):
                if frames := camera.poll(10_000 * tick):
                    break
                time.sleep(0.01)
            assert frames[0].image_bgr.shape == (480, 640, 3)
        process.send_signal(signal.SIGINT)
        assert json.loads(process.stdout.read())["contacts"] == 0
        assert process.wait() == 0


def test_a_place_of_a_camera_that_is_none_is_refused() -> None:
    done = subprocess.run(autopilot_command("emulate", "--camera", "8090"), capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "--camera '8090': write HOST:PORT" in done.stderr


def test_the_floor_of_a_scenario_is_a_map_for_a_configuration(tmp_path: Path) -> None:
    command = autopilot_command("scenario", "markers", "paper-tank", "--out", str(tmp_path / "floor.toml"))
    subprocess.run(command, check=True)
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode != 0 and "--force" in again.stderr
    read, meant = load_marker_map(tmp_path / "floor.toml"), given_markers(load_scenario("paper-tank"))
    assert meant is not None and read.ids.tolist() == meant.ids.tolist()
    assert np.abs(read.corners_ned_m - meant.corners_ned_m).max() < 2e-6


@pytest.mark.parametrize("command", [emulate, physics])
@pytest.mark.parametrize(
    ("arguments", "wrong"),
    [
        (("--frame", "vectored_6dof"), "vectored_6dof has motors 1 to 8; use --vehicle bluerov2 with"),
        (("--vehicle", "lbv150"), "vehicle 'lbv150': ArduSub's frame vectored has motors 1 to 6"),
        (("--truth", "/nodir/x"), "--truth /nodir/x: cannot be written (No such file or directory)"),
    ],
)
def test_what_cannot_be_simulated_is_refused_before_anything_is_opened(
    command: click.Command, arguments: tuple[str, ...], wrong: str
) -> None:
    done = CliRunner().invoke(command, (*arguments, "--camera", "127.0.0.1:0", "--pose", "udpin:192.0.2.1:9"))
    assert isinstance(done.exception, ConfigError) and wrong in str(done.exception)
    assert "[devices.camera]" not in done.output


@pytest.mark.parametrize(
    ("arguments", "pose"),
    [
        ((), ["udpout:127.0.0.1:14540"]),
        (("--camera", "127.0.0.1:8090"), []),
        (("--camera", "127.0.0.1:8090", "--pose", "udpout:127.0.0.1:1"), ["udpout:127.0.0.1:1"]),
        (("--pose", "off"), []),
    ],
)
def test_a_tracking_system_where_there_is_no_camera_or_as_asked(
    arguments: tuple[str, ...], pose: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a flight by markers would be one by its poses."""
    seen: list[list[str]] = []

    def emulated(*_: object, pose: list[str], **__: object) -> EmulatedFlight:
        seen.append(pose)
        return EmulatedFlight()

    monkeypatch.setattr("autopilot.run.sitl_physics.emulate", emulated)
    done = CliRunner().invoke(emulate, arguments)
    assert done.exit_code == 0, done.output
    assert seen == [pose]
