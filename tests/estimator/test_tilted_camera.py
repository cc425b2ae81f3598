"""A marker camera tilted away from where it was calibrated gives no position, however good its pictures look."""

import math

import msgspec
import numpy as np
from truth import Faults, World, uniform_current

from autopilot.core.messages import NavHealth
from autopilot.core.samples import CameraTiltSample, PoseSample
from autopilot.core.vehicle import PayloadTable, load_vehicle
from autopilot.estimator.create import create_estimator

CALIBRATED_DEG = -45.0
TILT = PayloadTable(name="camera tilt", kind="tilt", channel=9, camera_deg=CALIBRATED_DEG)
AWAY_M = np.array([0.4, -0.3, 0.1])
"""What a picture of the tilted camera is wrong by."""


class Flight:
    """With reports of the tilt, and wrong poses while it is away."""

    def __init__(self) -> None:
        vehicle = msgspec.structs.replace(load_vehicle("lbv150"), payload=(TILT,))
        self.estimator = create_estimator("ekf", vehicle, None, floor_depth_m=1.5)
        self.world = World(uniform_current, Faults(seed=4))
        self.tilt_deg: float | None = CALIBRATED_DEG
        self.worst_m = 0.0
        self.texts: list[str] = []

    def run(self, seconds: float, *, late_us: int = 0) -> NavHealth | None:
        """``late_us``: reports come so much after the motion."""
        begin_us, nav = self.world.t_us, None
        for truth, samples, thrust in self.world.run(seconds):
            t_us = truth.t_us
            away = self.tilt_deg is None or abs(self.tilt_deg - CALIBRATED_DEG) > 1.0
            shown = [_shifted(s) if away and isinstance(s, PoseSample) and s.t_us > begin_us else s for s in samples]
            if self.tilt_deg is not None and t_us % 200_000 == 0 and t_us - begin_us >= late_us:
                shown.append(CameraTiltSample(t_us=t_us, angle_rad=math.radians(self.tilt_deg)))
            nav = self.estimator.step(t_us, shown, thrust)
            self.texts += self.estimator.take_remarks()
            if nav is not None and nav.health is NavHealth.GOOD:
                self.worst_m = max(self.worst_m, float(np.abs(nav.pos_ned_m - truth.pos).max()))
        return None if nav is None else nav.health


def _shifted(sample: PoseSample) -> PoseSample:
    return PoseSample(
        t_us=sample.t_us,
        pos_ned_m=sample.pos_ned_m + AWAY_M,
        yaw_rad=sample.yaw_rad,
        sigma_pos_m=sample.sigma_pos_m,
        sigma_yaw_rad=sample.sigma_yaw_rad,
    )


def test_pictures_of_a_tilted_camera_are_left_out_and_used_again() -> None:
    flight = Flight()
    assert flight.run(5.0) is NavHealth.GOOD and flight.texts == []
    flight.tilt_deg = -20.0
    assert flight.run(4.0) is NavHealth.DEAD_RECKONING
    assert flight.texts == ["Camera at -20 deg, markers need -45: tilt it"]
    assert flight.estimator.counters()["frames.tilted"] > 20
    flight.tilt_deg = CALIBRATED_DEG
    assert flight.run(4.0) is NavHealth.GOOD
    assert flight.texts[1:] == ["Camera is tilted back: markers are used again"]
    assert flight.worst_m < 0.1


def test_a_camera_whose_angle_nobody_reports_gives_no_position() -> None:
    flight = Flight()
    flight.tilt_deg = None
    assert flight.run(3.0) is None
    assert flight.texts == ["Camera tilt unknown, no markers: see output 9"]
    flight.tilt_deg = CALIBRATED_DEG
    assert flight.run(4.0) is NavHealth.GOOD


def test_a_degree_of_play_is_borne() -> None:
    flight = Flight()
    flight.tilt_deg = CALIBRATED_DEG + 0.9
    assert flight.run(5.0) is NavHealth.GOOD and flight.texts == []
