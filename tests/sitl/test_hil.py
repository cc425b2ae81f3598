"""A simulated vehicle on real wires: what is between plant and service is what a vehicle has."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from autopilot.core.errors import ConfigError
from autopilot.core.samples import AhrsSample, CameraFrame
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.retry import DeviceState
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_session import open_sitl
from autopilot.sitl.backend import SimulatedVehicle, simulated_vehicle
from autopilot.sitl.hil import BoardOutput, NetworkCamera, SerialAhrs, Wire
from autopilot.sitl.scenario import load_scenario

SCENARIO = load_scenario("paper-tank")
VEHICLE = load_vehicle(SCENARIO.vehicle.model)


class Drive:
    """Ticks of a wired vehicle, each followed by a moment for the operating system."""

    def __init__(self, vehicle: SimulatedVehicle) -> None:
        self.vehicle, self.t_us = vehicle, 0
        self.samples: list[AhrsSample] = []
        self.frames: list[CameraFrame] = []

    def until(self, look: Callable[[], bool], pulses: tuple[int, ...] | None = None) -> None:
        for _ in range(3000):
            self.t_us += 10_000
            self.vehicle.advance(self.t_us)
            self.samples += [s for s in self.vehicle.poll(self.t_us) if isinstance(s, AhrsSample)]
            self.frames += self.vehicle.frames(self.t_us)
            if pulses is not None:
                self.vehicle.write(pulses)
            if look():
                return
            time.sleep(0.002)
        raise AssertionError("it does not happen")


def wired(*names: Wire) -> SimulatedVehicle:
    position = "camera" if "camera" in names else "pose"
    return simulated_vehicle(SCENARIO, VEHICLE, position=position, paced=True, hil=frozenset(names))


def test_attitude_comes_over_the_serial_line_and_comes_back_after_a_pulled_cable() -> None:
    with wired("serial") as vehicle:
        drive, ahrs = Drive(vehicle), vehicle._ahrs
        assert isinstance(ahrs, SerialAhrs)
        drive.until(lambda: len(drive.samples) > 100)
        truth = vehicle.truth
        assert np.abs(drive.samples[-1].rpy_rad[:2] - truth.rpy_rad[:2]).max() < 0.05
        stamps = [sample.t_us for sample in drive.samples]
        assert stamps == sorted(set(stamps))
        assert np.median(np.diff(stamps)) == pytest.approx(10_000, abs=1_000)
        ahrs.line.unplug()
        drive.until(lambda: ahrs._steady.state is DeviceState.DOWN)
        before = len(drive.samples)
        ahrs.line.open()
        drive.until(lambda: len(drive.samples) > before + 50)


def test_pulses_reach_the_plant_through_the_board() -> None:
    with wired("pwm") as vehicle:
        drive = Drive(vehicle)
        assert isinstance(vehicle.output, BoardOutput)
        drive.until(lambda: vehicle.truth.vel_water_frd_m_s[0] > 0.1, (1750, 1750, 1500, 1500))
        assert vehicle.output.pwm_us == pytest.approx((1750, 1750, 1500, 1500), abs=1)
        vehicle.output.chip.power_up()  # the board loses its power
        for _ in range(60):
            drive.t_us += 10_000
            try:
                vehicle.advance(drive.t_us)
                vehicle.write((1750, 1750, 1500, 1500))
            except Exception as error:  # noqa: BLE001 - the runtime tells it to the operator
                assert "has lost its settings" in str(error)
                break
        else:
            raise AssertionError("nobody notices")


def test_pictures_come_over_the_network() -> None:
    with wired("camera") as vehicle:
        drive, camera = Drive(vehicle), vehicle._camera
        assert isinstance(camera, NetworkCamera)
        drive.until(lambda: len(drive.frames) >= 3)
        assert drive.frames[-1].image_bgr.shape == (480, 640, 3)
        assert drive.frames[-1].image_bgr.std() > 5.0  # a floor with markers
        assert drive.frames[-1].t_us < drive.t_us


@pytest.mark.parametrize("speed", [0.0, 0.5, 2.0])
def test_wires_need_real_time(speed: float) -> None:
    settings = gather(sitl_defaults(0), {"speed": speed, "hil": ("serial",), "connect": ()}, {})
    with pytest.raises(ConfigError, match=f"--hil takes the time that bytes take, --speed {speed:g} does not; use"):
        open_sitl(settings, {}, log=False)
