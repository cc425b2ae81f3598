"""While the estimate is not good some pictures are searched for everything: what should be in view may be wrong."""

import numpy as np
import pytest

from autopilot.core.messages import NavHealth, NavState
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.estimator.frame_filter import FrameFilter
from autopilot.estimator.vision import Hint
from autopilot.estimator.vision_worker import ACQUISITION_EVERY, SUSPECT_EVERY, VisionWorker

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


def searched(health: NavHealth, *, found: bool = True, count: int = 18) -> list[tuple[int, bool]]:
    detector, rng = Noting(found=found), np.random.default_rng(1)
    worker = VisionWorker(detector, delay_s=0.0, frame_filter=FrameFilter(SHAPE[1], SHAPE[0]))
    for k in range(count):
        image = rng.integers(20, 220, SHAPE, dtype=np.uint8)
        worker.submit(k, CameraFrame(t_us=k, image_bgr=image), nav(health))
        worker.collect(k)
    worker.close()
    return detector.searched


def test_a_good_estimate_is_always_the_hint() -> None:
    assert searched(NavHealth.GOOD) == [(k, True) for k in range(18)]


def test_in_dead_reckoning_every_third_picture_is_searched_without() -> None:
    assert searched(NavHealth.DEAD_RECKONING) == [(k, k % SUSPECT_EVERY != 0) for k in range(18)]


@pytest.mark.parametrize(("found", "every"), [(True, SUSPECT_EVERY), (False, ACQUISITION_EVERY)])
def test_a_lost_vehicle_looks_more_often_once_there_is_something_to_see(found: bool, every: int) -> None:
    times = [t_us for t_us, hinted in searched(NavHealth.INVALID, found=found) if not hinted]
    assert times[0] == 0 and np.diff(times[1:]).tolist() == [every] * (len(times) - 2)
