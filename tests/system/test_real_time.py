"""At a speed the loop waits for nobody, not for the detector and not for the disk: here they wait for the loop."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from wire_client import ArmingSchedule

from autopilot.core.messages import Outputs
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.estimator.vision import Hint, MarkerDetector
from autopilot.log import writer
from autopilot.log.reader import open_log
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl

SPEED = 5.0
PATIENCE_S = 60.0
"""How long something waits for a loop that is stuck before the test goes on to fail."""


class Progress:
    """How far the loop is; others wait for it to go on."""

    def __init__(self) -> None:
        self._ticks = 0
        self._moved = threading.Condition()
        self.stuck = False

    def tick(self, _: Outputs) -> None:
        with self._moved:
            self._ticks += 1
            self._moved.notify_all()

    def wait(self, ticks: int) -> None:
        """Return when the loop has gone on by so many ticks."""
        with self._moved:
            until = self._ticks + ticks
            self.stuck |= not self._moved.wait_for(lambda: self.stuck or self._ticks >= until, PATIENCE_S)

    def release(self) -> None:
        with self._moved:
            self._ticks += 1_000_000
            self._moved.notify_all()


def _session(folder: Path, *, on_tick: Callable[[Outputs], None] = lambda _: None, **given: Any) -> SitlSession:
    peers = given.pop("peers", ())
    settings = flight_settings(
        folder / "state", {"speed": SPEED, "sensors": "pose", **given, "log_dir": str(folder / "logs")}
    )
    return open_sitl(settings, {"FENCE_REQUIRED": 0.0}, peers=peers, on_tick=on_tick)


class SlowDetector(MarkerDetector):
    """Needs the time of 15 ticks for each picture, in a loop that must go on meanwhile."""

    progress: Progress
    seen_us: list[int]

    def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
        self.seen_us.append(frame.t_us)
        self.progress.wait(15)
        return super().detect(frame, hint)


def test_a_slow_detector_does_not_hold_the_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """150 ms per picture of a camera with 33 ms between them: the newest ones are looked at, their times are true."""
    progress = Progress()
    monkeypatch.setattr(SlowDetector, "progress", progress, raising=False)
    monkeypatch.setattr(SlowDetector, "seen_us", [], raising=False)
    monkeypatch.setattr("autopilot.run.session.MarkerDetector", SlowDetector)
    session = _session(
        tmp_path, speed=1.0, sensors="camera", duration=4.0, on_tick=progress.tick, log=str(tmp_path / "a.mcap")
    )
    vision = session.runtime._vision
    assert vision is not None
    close = vision.close
    monkeypatch.setattr(vision, "close", lambda: (progress.release(), close()))
    session.run()
    assert not progress.stuck
    assert session.runtime.counters.ticks == 400
    seen_us = SlowDetector.seen_us
    assert 3 <= len(seen_us) <= 400 / 15
    assert vision.counters()["frames.dropped"] > 0
    sightings = open_log(tmp_path / "a.mcap")["/in/markers"]["t_us"]
    assert len(sightings) >= 2
    assert sightings.tolist() == seen_us[: len(sightings)]


def test_a_slow_disk_does_not_hold_the_loop_and_nothing_of_the_first_moments_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Making the file at arming takes a second, finishing it at disarming another one: the loop sees neither."""
    progress = Progress()
    make, finish = writer._open_locked, writer.LogWriter._finish

    def slow_make(path: Path) -> Any:
        progress.wait(100)
        return make(path)

    def slow_finish(self: writer.LogWriter) -> None:
        progress.wait(100)
        finish(self)

    monkeypatch.setattr(writer, "_open_locked", slow_make)
    monkeypatch.setattr(writer.LogWriter, "_finish", slow_finish)
    operator = ArmingSchedule({2.0: 1, 4.0: 0})
    session = _session(tmp_path, duration=6.0, peers=[operator], on_tick=progress.tick)
    session.run()
    assert not progress.stuck
    assert session.recorder.failure is None and session.recorder.dropped == 0
    (path,) = sorted((tmp_path / "logs").rglob("*.mcap"))
    log = open_log(path)
    assert not log.problems
    mode = log["/sys/mode"]
    assert mode["armed"][0] == 1 and mode["armed"][-1] == 0
    assert mode["t_us"][0] * 1e-6 == pytest.approx(2.0, abs=0.05)
    assert log["/nav/state"]["t_us"][0] == mode["t_us"][0]


def test_a_queue_that_is_full_drops_counts_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    progress = Progress()
    monkeypatch.setattr(writer, "QUEUE_MESSAGES", 50)
    make = writer._open_locked

    def slow_make(path: Path) -> Any:
        progress.wait(100)
        return make(path)

    monkeypatch.setattr(writer, "_open_locked", slow_make)
    operator = ArmingSchedule({2.0: 1, 4.0: 0})
    session = _session(tmp_path, duration=5.0, peers=[operator], on_tick=progress.tick)
    session.run()
    assert not progress.stuck
    assert session.recorder.dropped > 0 and session.recorder.failure is not None
    assert len(operator.texts_from("Log loses messages: disk too slow")) == 1


@pytest.mark.parametrize("speed", [0.0, 20.0])
def test_a_log_folder_that_is_gone_is_said_at_once_and_tried_again(tmp_path: Path, speed: float) -> None:
    logs = tmp_path / "logs"

    def spoil() -> None:
        logs.rmdir()
        logs.write_bytes(b"a file in the folder's place")

    operator = ArmingSchedule({2.0: 1, 3.0: 0, 4.0: 1, 5.0: 0}, {1.0: spoil, 3.5: logs.unlink})
    session = _session(tmp_path, speed=speed, duration=6.0, peers=[operator])
    session.run()
    assert session.runtime.counters.ticks == 600
    ((said_s, severity, text),) = operator.texts_from("Log stopped")
    assert (severity, text) == (4, "Log stopped: folder gone")
    assert 2.0 < said_s < 3.0
    (path,) = sorted(logs.rglob("*.mcap"))
    assert open_log(path)["/sys/mode"]["t_us"][0] * 1e-6 == pytest.approx(4.0, abs=0.05)
    assert session.recorder.failure is not None
