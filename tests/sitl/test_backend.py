"""The simulated vehicle behind the drivers' protocols."""

import hashlib
from collections.abc import Sequence
from typing import Any, Literal

import msgspec
import numpy as np
import pytest
from sensor_helpers import SCENARIO, VEHICLE, truth_at

from autopilot.core.errors import ConfigError, DriverError
from autopilot.core.samples import AhrsSample, CameraFrame, LaserSample, PoseSample, PowerSample, Sample
from autopilot.drivers.protocols import BytePort, Sensor, ThrusterOutput
from autopilot.sitl.ahrs import Ig500Emulator
from autopilot.sitl.backend import PowerMonitor, SimulatedVehicle, simulated_vehicle
from autopilot.sitl.plant import Truth
from autopilot.sitl.pose_sensor import SimPoseSensor
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.scenario_tables import CameraBlackout, Scenario, ThrusterLoss
from autopilot.sitl.sensor_tables import AhrsSensor, CameraSensor, LaserSensor, PoseSensor, Sensors

PUSH = (1600, 1600, 1500, 1500)


def scenario_with(**changes: Any) -> Scenario:
    return msgspec.structs.replace(SCENARIO, **changes)


def exact_cameras(**changes: Any) -> Sensors:
    """No jitter, nothing lost."""
    return Sensors(camera=CameraSensor(latency_jitter_s=0.0, drop_probability=0.0, **changes))


class RecordingPlant:
    """Stands still and remembers what was asked of it."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, tuple[int, ...]]] = []
        self.t_us = 0

    @property
    def truth(self) -> Truth:
        return truth_at((0.0, 0.0, 0.4), t_us=self.t_us)

    def advance(self, t_us: int, pwm_us: Sequence[int]) -> None:
        assert t_us >= self.t_us
        self.t_us = t_us
        self.asked.append((t_us, tuple(pwm_us)))


def run(
    vehicle: SimulatedVehicle, duration_s: float, pwm_us: tuple[int, ...] | None = PUSH
) -> tuple[list[tuple[int, Sample]], list[tuple[int, CameraFrame]]]:
    """All samples and pictures with the tick at which they came."""
    samples: list[tuple[int, Sample]] = []
    frames: list[tuple[int, CameraFrame]] = []
    with vehicle:
        for t_us in range(0, round(duration_s * 1e6) + 1, 10_000):
            vehicle.advance(t_us)
            samples += [(t_us, sample) for sample in vehicle.poll(t_us)]
            frames += [(t_us, frame) for frame in vehicle.frames(t_us)]
            if pwm_us is not None:
                vehicle.write(pwm_us)
    return samples, frames


def times(samples: Sequence[tuple[int, Any]], kind: type[Any]) -> list[int]:
    return [int(sample.t_us) for _, sample in samples if type(sample) is kind]


def test_parts_follow_the_drivers_protocols() -> None:
    with simulated_vehicle(SCENARIO, VEHICLE, position="pose") as vehicle:
        output: ThrusterOutput = vehicle.output
        sensor: Sensor[AhrsSample] = vehicle.ahrs
        power: Sensor[PowerSample] = PowerMonitor()
        pose: Sensor[PoseSample | LaserSample] = SimPoseSensor(PoseSensor(), LaserSensor(), VEHICLE, 1.5, [], 1)
        port: BytePort = Ig500Emulator(AhrsSensor(), VEHICLE.ahrs, [], 1)
        assert output.check(0)
        for arrived in (sensor.poll(0), power.poll(0), pose.poll(0), port.read(0)):
            assert not arrived


def test_pose_run_delivers_every_kind_of_sample() -> None:
    samples, frames = run(simulated_vehicle(SCENARIO, VEHICLE, position="pose"), 3.0)
    assert len(times(samples, AhrsSample)) == pytest.approx(299, abs=2)
    assert len(times(samples, PoseSample)) == pytest.approx(88, abs=5)
    assert len(times(samples, LaserSample)) == len(times(samples, PoseSample))
    assert times(samples, PowerSample) == [0, 500_000, 1_000_000, 1_500_000, 2_000_000, 2_500_000, 3_000_000]
    assert frames == []
    assert all(sample.t_us <= tick for tick, sample in samples)


def test_pictures_are_exposed_on_exact_ticks_and_arrive_after_half_of_the_latency() -> None:
    scenario = scenario_with(sensors=exact_cameras())
    _, frames = run(simulated_vehicle(scenario, VEHICLE, position="camera"), 1.0)
    assert [frame.t_us for _, frame in frames] == [k * 1_000_000 // 30 for k in range(len(frames))]
    assert len(frames) == 30  # 0 to 966666; the one of 1.0 s is on its way
    for tick, frame in frames:
        assert 30_000 <= tick - frame.t_us < 40_000
        assert frame.image_bgr.shape == (480, 640, 3)


def test_lost_pictures_and_blackout() -> None:
    scenario = scenario_with(sensors=exact_cameras(), fault=[CameraBlackout(at_s=0.4, duration_s=0.3)])
    _, frames = run(simulated_vehicle(scenario, VEHICLE, position="camera"), 1.0)
    seen = [frame.t_us for _, frame in frames]
    assert [t for t in seen if 400_000 <= t < 700_000] == []
    assert len(seen) == 30 - 9
    sensors = Sensors(camera=CameraSensor(latency_jitter_s=0.0, drop_probability=0.5))
    _, frames = run(simulated_vehicle(scenario_with(sensors=sensors), VEHICLE, position="camera"), 1.0)
    assert 6 <= len(frames) <= 24


@pytest.mark.parametrize("position", ["camera", "pose"])
def test_same_seed_same_run_bit_for_bit(position: Literal["camera", "pose"]) -> None:
    def digest(seed: int) -> str:
        samples, frames = run(simulated_vehicle(SCENARIO, VEHICLE, seed=seed, position=position), 0.4)
        sha = hashlib.sha256()
        for tick, sample in samples:
            sha.update(f"{tick} {type(sample).__name__} {sample.t_us}".encode())
            if isinstance(sample, AhrsSample):
                sha.update(sample.rpy_rad.tobytes() + sample.rate_frd_rad_s.tobytes())
            elif isinstance(sample, PoseSample):
                sha.update(sample.pos_ned_m.tobytes())
        for tick, frame in frames:
            sha.update(f"{tick} {frame.t_us}".encode() + frame.image_bgr.tobytes())
        return sha.hexdigest()

    first = digest(1)
    assert digest(1) == first
    assert digest(2) != first


def test_pulses_reach_the_plant_and_stop_when_commands_stop() -> None:
    plant = RecordingPlant()
    vehicle = SimulatedVehicle(SCENARIO, VEHICLE, plant, seed=1, position="pose")
    with vehicle:
        vehicle.advance(0)
        vehicle.write((1600, 1700, 1500, 1400, 0, 0, 0, 0))
        for t_us in range(10_000, 1_000_000, 10_000):
            vehicle.advance(t_us)
    moving = [t for t, pwm in plant.asked if pwm == (1600, 1700, 1500, 1400)]
    assert min(moving) == 10_000
    assert max(moving) == round(VEHICLE.drive.command_timeout_s * 1e6)
    assert plant.asked[-1] == (990_000, (1500, 1500, 1500, 1500))
    assert vehicle.output.pwm_us == (1500, 1500, 1500, 1500)
    with pytest.raises(DriverError, match="closed"):
        vehicle.write(PUSH)


def test_commands_arrive_after_their_latency() -> None:
    plant = RecordingPlant()
    late = msgspec.structs.replace(SCENARIO, vehicle=msgspec.structs.replace(SCENARIO.vehicle, command_latency_s=0.205))
    with SimulatedVehicle(late, VEHICLE, plant, seed=1, position="pose") as vehicle:
        for t_us in range(0, 600_000, 10_000):
            vehicle.advance(t_us)
            vehicle.write((1600 + t_us // 10_000, 1500, 1500, 1500, 0, 0, 0, 0))
    asked = plant.asked
    assert [pwm[0] for t, pwm in asked if t <= 205_000] == [1500] * sum(t <= 205_000 for t, _ in asked)
    for t_us, pwm in asked:
        if t_us > 205_000:
            # What was sent no later than the beginning of this step minus the latency.
            assert pwm[0] == 1600 + (t_us - 1 - 205_000) // 10_000, t_us


def test_sensors_look_at_their_own_times_and_not_only_at_ticks() -> None:
    plant = RecordingPlant()
    run(SimulatedVehicle(SCENARIO, VEHICLE, plant, seed=1, position="pose"), 0.1)
    assert {33_333, 66_667} <= {t for t, _ in plant.asked}


def test_thruster_loss_strikes_at_its_time() -> None:
    faults = [ThrusterLoss(at_s=0.5, thruster="port", loss=0.4), ThrusterLoss(at_s=0.0, thruster="starboard")]
    vehicle = simulated_vehicle(scenario_with(fault=faults), VEHICLE, seed=1, position="pose")
    thrust_n = {}
    with vehicle:
        for t_us in range(0, 1_000_001, 10_000):
            vehicle.advance(t_us)
            vehicle.write(PUSH)
            thrust_n[t_us] = vehicle.truth.thrust_n[:2].tolist()
    assert thrust_n[500_000][0] > 0.5
    assert thrust_n[510_000][0] == pytest.approx(0.6 * thrust_n[500_000][0], rel=0.05)
    assert {starboard for _, starboard in thrust_n.values()} == {0.0}


def test_truth_is_the_present_one() -> None:
    vehicle = simulated_vehicle(SCENARIO, VEHICLE, position="pose")
    with vehicle:
        assert vehicle.truth.t_us == 0
        for t_us in (0, 10_000, 20_000):
            vehicle.advance(t_us)
            assert vehicle.truth.t_us == t_us
        vehicle.write(PUSH)
        for t_us in range(30_000, 1_500_000, 10_000):
            vehicle.advance(t_us)
            vehicle.write(PUSH)
        assert vehicle.truth.vel_frd_m_s[0] > 0.1
        assert np.linalg.norm(vehicle.truth.pos_ned_m - SCENARIO.vehicle.start_m) > 0.1


def test_cameras_need_a_floor() -> None:
    with pytest.raises(ConfigError, match=r"'open-water' has no \[tank\].*--sensors pose"):
        simulated_vehicle(load_scenario("open-water"), VEHICLE, position="camera")
    assert simulated_vehicle(load_scenario("open-water"), VEHICLE).markers is None


def test_marker_map_is_offered_with_pictures() -> None:
    vehicle = simulated_vehicle(SCENARIO, VEHICLE)
    assert vehicle.markers is not None
    assert len(vehicle.markers.ids) > 2000
