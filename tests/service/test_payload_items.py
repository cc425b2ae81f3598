"""Missions that photograph, grip and switch: uploaded over MAVLink, flown on the model."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from mission_world import MissionWorld

from autopilot.core.background import BackgroundWorker
from autopilot.core.messages import Outputs
from autopilot.core.samples import CameraFrame, Sample
from autopilot.core.stills import StillRecord
from autopilot.mission.plan_model import PlanFile
from autopilot.run.plan_verdict import verdict_of
from autopilot.run.still_files import StillStore
from tests.plan_items import NAN, ORIGIN, plain, waypoint

START = (-1.2, 0.6, 0.5, 0.0)
EXPOSURE_US = 33_333


class CameraWorld(MissionWorld):
    """With a camera of 30 Hz whose pictures come 50 ms late, and the store that the runtime has."""

    pictures = True

    def __init__(self, folder: Path) -> None:
        self.path: Path | None = folder / "run.mcap"
        self.stored: list[int] = []
        self.stills: list[StillRecord] = []
        self._store = StillStore(self, BackgroundWorker(), folder)
        super().__init__(START)

    def still(self, exposure_us: int, png: bytes) -> None:
        assert png.startswith(b"\x89PNG")
        self.stored.append(exposure_us)

    def camera(self) -> dict[str, Any]:
        exposed = self.t_us - 50_000
        frames = [
            CameraFrame(t_us=number * EXPOSURE_US, image_bgr=np.full((48, 64, 3), number % 256, np.uint8))
            for number in range(max(1, -(-(exposed - 9_999) // EXPOSURE_US)), exposed // EXPOSURE_US + 1)
        ]
        return {"stills": self._store.take(self.t_us, frames), "camera": self._store.report()}

    def tick(self, rx: Sequence[bytes] = (), samples: Sequence[Sample] | None = None) -> Outputs:
        outputs = super().tick(rx, samples)
        self._store.request(self.t_us, outputs.shots)
        self.stills += outputs.stills
        return outputs


def survey() -> list[Any]:
    """As QGroundControl's survey has it: trigger by distance on the transect, off behind it."""
    return [
        waypoint(0, -1.2, 0.6),
        plain(1, 206, 0.25, 0.0, 1.0),
        waypoint(2, 0.8, 0.9),
        plain(3, 206, 0.0, 0.0, 0.0),
        waypoint(4, 1.2, 0.6),
    ]


def test_a_survey_photographs_by_the_way_with_the_pose_of_each_exposure(tmp_path: Path) -> None:
    world = CameraWorld(tmp_path)
    world.run(0.5)
    world.fly(survey(), 20.0)
    assert 4 in world.reached, world.texts()
    places = np.array([still.pos_ned_m for still in world.stills])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert 7 <= len(places) <= 10, "two metres at a quarter of one each"
    # A still may come one period of the camera after the quarter metre is full.
    assert steps.min() > 0.22 and steps.max() < 0.25 + 0.05, steps
    assert places[:, 0].max() < 1.0, "none behind the transect"
    assert {still.seq for still in world.stills} == {1}
    track = np.array(world.track)
    for still, exposure_us in zip(world.stills, world.stored, strict=True):
        assert still.still.exposure_us == exposure_us and exposure_us % EXPOSURE_US == 0
        assert still.pos_ned_m is not None and still.rpy_rad is not None
        true = track[exposure_us // 10_000 - 1]
        assert np.linalg.norm(still.pos_ned_m - true[:3]) < 0.02
        assert abs(still.rpy_rad[2] - true[3]) < 0.05
    captured = [m for m in world.inbox if m.get_type() == "CAMERA_IMAGE_CAPTURED"]
    assert [m.image_index for m in captured] == list(range(len(places)))
    assert len(list(tmp_path.glob("run.still-*.png"))) == len(places)


def test_a_survey_that_goes_on_after_disarming_photographs_on(tmp_path: Path) -> None:
    """The rest of the transect was flown without photos, and nobody was told."""
    world = CameraWorld(tmp_path)
    world.run(0.5)
    world.fly(survey(), 4.5)
    assert world.command(400, 0.0) == 0
    world.run(1.0)
    before = len(world.stills)
    assert 2 <= before <= 5
    world.arm()
    assert world.command(300, 0.0, 0.0) == 0
    world.run(16.0)
    assert 4 in world.reached, world.texts()
    places = np.array([still.pos_ned_m for still in world.stills])
    assert 7 <= len(places) <= 11 and places[:, 0].max() < 1.0
    assert {still.seq for still in world.stills} == {1}
    count = len(places)
    assert world.command(400, 0.0) == 0
    world.arm()
    assert world.command(300, 0.0, 0.0) == 0
    world.run(0.5)
    assert len(world.stills) == count, "a mission that was complete begins anew"


def test_orders_that_are_still_to_come_are_not_given_again(tmp_path: Path) -> None:
    world = CameraWorld(tmp_path)
    world.run(0.5)
    world.fly(survey(), 6.0)
    assert world.command(400, 0.0) == 0
    world.run(1.0)
    world.arm()
    count = len(world.stills)
    assert world.command(224, 0.0) == 0
    assert world.command(300, 0.0, 0.0) == 0
    world.run(1.0)
    assert len(world.stills) == count


def test_stills_by_time_in_a_mission_end_with_it(tmp_path: Path) -> None:
    world = CameraWorld(tmp_path)
    world.run(0.5)
    world.fly([plain(0, 2000, 0.0, 0.5, 0.0), plain(1, 93, 1.75), plain(2, 2001), plain(3, 93, 0.8)], 3.0)
    assert len(world.stills) == 4
    assert {still.seq for still in world.stills} == {0}
    assert world.command(400, 0.0) == 0
    world.fly([plain(0, 2000, 0.0, 0.5, 0.0), plain(1, 93, 60.0)], 0.7)
    before = len(world.stills)
    assert before > 4
    assert world.command(400, 0.0) == 0  # disarmed on the way: nobody photographs on
    world.run(2.0)
    assert len(world.stills) - before <= 1


def test_without_a_camera_a_survey_is_flown_and_that_is_told_once() -> None:
    world = MissionWorld(START)
    world.run(0.5)
    assert world.upload(survey()).type == 0
    world.arm()
    assert world.command(300, 0.0, 0.0) == 0
    world.run(19.0)
    assert 4 in world.reached
    assert world.texts().count("Item 1 (QGC 2): no camera here, no photos") == 1


def test_a_mission_grips_and_switches() -> None:
    world = MissionWorld(START)
    world.run(0.5)
    states = []
    ack = world.upload(
        [
            plain(0, 211, 1.0, 1.0),
            plain(1, 181, 0.0, 1.0),
            plain(2, 183, 17.0, 1400.0),
            plain(3, 93, 1.0),
            plain(4, 182, 0.0, 2.0, 0.4),
            plain(5, 187, 1.0, NAN, NAN, NAN),
            plain(6, 93, 2.0),
        ]
    )
    assert ack.type == 0, world.texts()
    world.arm()
    assert world.command(300, 0.0, 0.0) == 0
    for _ in range(400):
        state = world.tick().payload
        assert state is not None
        states.append(state.pulses_us)
    seen = list(dict.fromkeys(states))
    assert (1400, 1100, 1900) in seen
    assert seen[-1] in ((1900, 1100, 1900), (1900, 1100, 1100))
    assert sum(a[2] != b[2] for a, b in pairwise(states)) == 4, "twice off and on"
    assert states[-1] == (1900, 1100, 1900)


REFUSED = (
    (plain(0, 183, 1.0, 1500.0), "drives thruster"),
    (plain(0, 183, 7.0, 1500.0), "no servo 7"),
    (plain(0, 183, 17.0, 2500.0), "use 1100 to 1900"),
    (plain(0, 181, 4.0, 1.0), "no relay 4"),
    (plain(0, 181, 0.0, 5.0), "setting (param2)"),
    (plain(0, 182, 0.0, 0.0, 1.0), "count (param2)"),
    (plain(0, 211, 3.0, 1.0), "no gripper 3"),
    (plain(0, 187, 1.5), "use -1 to 1"),
    (plain(0, 2000, 0.0, 0.0, 5.0), "interval (param2)"),
    (plain(0, 2000, 0.0, 1.0, -5.0), "count (param3)"),
    (plain(0, 206, -1.0), "distance (param1)"),
    (plain(0, 2500, 0.0, 0.0), "takes stills only"),
    (plain(0, 530, 0.0, 1.0), "takes stills only"),
    (plain(0, 205, -90.0), "camera is fixed"),
)


def test_what_nothing_can_do_is_refused_at_the_upload() -> None:
    world = MissionWorld(START)
    world.run(0.1)
    for item, text in REFUSED:
        assert world.upload([item]).type != 0, item
        assert "item 0" in world.texts() and text in world.texts(), (text, world.texts())
        verdict = verdict_of(PlanFile(mission=(item,)), ORIGIN, world.parts.params, world.vehicle)
        assert verdict.problem.removeprefix("item 0: ") in world.texts(), "as the check of a file says"
        assert text in verdict.problem
