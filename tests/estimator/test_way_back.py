"""While the estimate is not good some pictures are searched for everything: what should be in view may be wrong."""

import numpy as np
import pytest

from autopilot.core.messages import NavHealth, NavState
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.estimator.frame_filter import FrameFilter
from autopilot.estimator.startup import SLOW_WINDOW_US
from autopilot.estimator.vision import Hint
from autopilot.estimator.vision_worker import (
    ACQUISITION_EVERY,
    ACQUISITION_US,
    FOUND_US,
    SUSPECT_EVERY,
    VisionWorker,
)

SHAPE = (48, 64, 3)


class Noting:
    """Says which pictures were searched, and whether with a hint."""

    def __init__(self, *, found: bool) -> None:
        self._ids = (1,) if found else ()
        self.searched: list[tuple[int, bool]] = []

    def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
        self.searched.append((frame.t_us, hint is not None))
        corners = np.zeros((len(self._ids), 4, 2))
        return MarkerSighting(t_us=frame.t_us, ids=self._ids, corners_px=corners, laser_px=None)


def nav(health: NavHealth) -> NavState:
    zero = np.zeros(3)
    places = dict.fromkeys(
        ("pos_ned_m", "rpy_rad", "vel_frd_m_s", "vel_water_frd_m_s", "rate_frd_rad_s", "current_ned_m_s"), zero
    )
    return NavState(t_us=0, health=health, variance=np.ones(12), **places)


def searched(health: NavHealth, rate_hz: float, *, found: bool = True) -> list[tuple[int, bool]]:
    """What was done with the pictures of four seconds."""
    detector, rng = Noting(found=found), np.random.default_rng(1)
    worker = VisionWorker(detector, delay_s=0.0, frame_filter=FrameFilter(SHAPE[1], SHAPE[0]))
    for k in range(round(4.0 * rate_hz)):
        image, t_us = rng.integers(20, 220, SHAPE, dtype=np.uint8), round(1e6 * k / rate_hz)
        worker.submit(t_us, CameraFrame(t_us=t_us, image_bgr=image), nav(health))
        worker.collect(t_us)
    worker.close()
    return detector.searched


def without(looks: list[tuple[int, bool]]) -> list[int]:
    return [t_us for t_us, hinted in looks if not hinted]


RATES = pytest.mark.parametrize("rate_hz", [5.0, 8.0, 10.0, 12.0, 20.0, 30.0, 60.0])


@RATES
def test_a_good_estimate_is_always_the_hint(rate_hz: float) -> None:
    looks = searched(NavHealth.GOOD, rate_hz)
    assert len(looks) == round(4.0 * rate_hz) and not without(looks)


@RATES
def test_in_dead_reckoning_every_third_picture_is_searched_without(rate_hz: float) -> None:
    looks = [hinted for _, hinted in searched(NavHealth.DEAD_RECKONING, rate_hz)]
    assert looks == [k % SUSPECT_EVERY != 0 for k in range(round(4.0 * rate_hz))]


@RATES
@pytest.mark.parametrize("found", [True, False])
def test_a_lost_vehicle_looks_more_often_once_there_is_something_to_see(found: bool, rate_hz: float) -> None:
    """At any rate often enough that three looks fall into the time in which fixes must agree."""
    times_us = without(searched(NavHealth.INVALID, rate_hz, found=found))
    every, longest_us = (SUSPECT_EVERY, FOUND_US) if found else (ACQUISITION_EVERY, ACQUISITION_US)
    gaps_us, frame_us = np.diff(times_us[1:]), 1e6 / rate_hz
    assert times_us[0] == 0 and gaps_us.max() <= min(every * frame_us, longest_us + frame_us) + 1
    assert gaps_us.min() >= min(every * frame_us - 1, longest_us) and 2 * gaps_us.max() < SLOW_WINDOW_US
