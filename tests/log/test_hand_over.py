"""Ticks are handed to the writer's thread as they are and packed there, however late."""

import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_synthetic import DESCRIPTION, EPOCH_NS, Run, inputs_at, outputs_at, truth_at
from pymavlink.dialects.v20 import common

from autopilot.core.messages import Inputs, MavlinkFrame, Outputs
from autopilot.log.description import RunDescription
from autopilot.log.log_session import RunLog, SimulationRecord
from autopilot.log.reader import open_log
from autopilot.log.writer import LogWriter, Payload
from autopilot.run.config import flight_settings
from autopilot.run.hardware_session import HardwareWorld
from autopilot.run.recorder import RunRecorder
from autopilot.run.sitl_session import open_sitl

Message = tuple[str, int, bytes]


class Kept:
    """A log in memory. What is handed over is packed ``at_once``, or by :meth:`pack`; ``refuses`` some of it."""

    epoch_ns = EPOCH_NS
    path, dropped, queued, failure, cause, finished = Path(), 0, (0, 0), None, "", False

    def __init__(self, *, at_once: bool, refuses: frozenset[int] = frozenset()) -> None:
        self.messages: list[Message] = []
        self._at_once, self._refuses = at_once, refuses
        self._waiting: list[Callable[[], None]] = []
        self._count = 0

    @property
    def sink(self) -> "Kept":
        return self

    def defer(self, topic: str, t_us: int, work: Callable[[], None], messages: int, size: int) -> bool:
        self._count += 1
        if self._count - 1 in self._refuses:
            return False
        self._waiting.append(work)
        if self._at_once:
            self.pack()
        return True

    def pack(self) -> None:
        waiting, self._waiting = self._waiting, []
        for work in waiting:
            work()

    def write(self, topic: str, t_us: int, payload: Payload) -> None:
        self.messages.append((topic, t_us, payload if isinstance(payload, bytes) else payload()))

    def write_packet(self, t_us: int, packet: bytes) -> None:
        self.write("tlog", t_us, packet)

    def attach(self, name: str, t_us: int, data: Payload) -> None:
        self.write(name, t_us, data)

    def take_error(self) -> Exception | None:
        return None

    def end(self) -> None:
        pass

    def close(self, timeout_s: float | None = None) -> None:
        pass


@pytest.mark.parametrize("sensors", ["pose", "camera"])
def test_nobody_changes_what_was_handed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sensors: str) -> None:
    """A flight packed tick by tick and once more when it is over: the same messages, bit for bit."""
    early, late = Kept(at_once=True), Kept(at_once=False)
    description = RunDescription(scenario="", vehicle="")
    logs = [RunLog(kept, description, camera_period_us=200_000) for kept in (early, late)]
    tick = RunLog.tick

    def both(
        self: RunLog, inputs: Inputs, outputs: Outputs, frames: object = (), world: SimulationRecord | None = None
    ) -> None:
        for log in logs:
            tick(log, inputs, outputs, frames, world)  # type: ignore[arg-type]

    monkeypatch.setattr(RunLog, "tick", both)
    duration_s = 4.0 if sensors == "pose" else 2.0
    given = {"speed": 0.0, "sensors": sensors, "start": True, "duration": duration_s, "log": str(tmp_path / "a.mcap")}
    made = flight_settings(tmp_path, given)
    open_sitl(made, {}).run()
    assert not late.messages
    late.pack()
    assert late.messages == early.messages
    wanted = {"/in/tick", "/in/ahrs_raw", "/sim/truth", "/nav/state", "/ctl/nmpc", "/ctl/horizon", "/out/mavlink"}
    assert wanted | ({"/in/camera", "/in/markers"} if sensors == "camera" else set()) <= {m[0] for m in late.messages}


MAV = common.MAVLink(None, srcSystem=7, srcComponent=9)
SECRET = list(range(100, 132))
HEARTBEAT = bytes(MAV.heartbeat_encode(12, 12, 0, 0, 4).pack(MAV))
KEY = bytes(MAV.setup_signing_encode(1, 1, SECRET, 0).pack(MAV))


@given(size=st.integers(1, 40), before=st.integers(0, 3), refused=st.frozensets(st.integers(0, 120)))
@settings(deadline=None, max_examples=60)
def test_a_key_does_not_pass_where_ticks_are_lost(size: int, before: int, refused: frozenset[int]) -> None:
    """Whatever has no room, the beginning of a key included; the stream is cut as before soon after."""
    stream = HEARTBEAT * before + KEY + HEARTBEAT * 12
    kept = Kept(at_once=True, refuses=refused)
    log = RunLog(kept, DESCRIPTION, camera_period_us=None)
    pieces = [stream[start : start + size] for start in range(0, len(stream), size)]
    pieces += [b""] * (122 - len(pieces)) + [HEARTBEAT] * 6  # behind all that has no room
    for tick, piece in enumerate(pieces):
        frame = MavlinkFrame(link=0, data=piece)
        log.inputs(Inputs(t_us=10_000 * tick, mavlink_rx=(frame,)))
    written = b"|".join(data for _, _, data in kept.messages)
    assert not any(bytes(SECRET[at : at + 3]) in written for at in range(len(SECRET) - 2))
    assert kept.messages[-1][0] == "tlog" or kept.messages[-2][0] == "tlog"
    assert [data for topic, _, data in kept.messages if topic == "tlog"][-1] == HEARTBEAT


def outputs_of(tick: int) -> tuple[Inputs, Outputs]:
    truth = truth_at(0.01 * tick)
    return inputs_at(10_000 * tick, truth), outputs_at(10_000 * tick, truth, Run())


def test_ticks_without_room_are_lost_whole_counted_and_seen_in_the_numbers(tmp_path: Path) -> None:
    gate, inside = threading.Event(), threading.Event()

    def slow() -> bytes:
        inside.set()
        assert gate.wait(30.0)
        return b"waited"

    writer = LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH_NS, metadata={}, attachments={}, queue_messages=200)
    log = RunLog(writer, DESCRIPTION)
    writer.attach("slow.txt", 0, slow)
    assert inside.wait(30.0)
    for tick in range(50):
        log.tick(*outputs_of(tick))
    lost, (messages, held) = writer.dropped, writer.queued
    assert lost > 0 and 200 <= messages < 300 and held > 4096
    gate.set()
    while log.writer.queued[0]:
        threading.Event().wait(0.01)
    log.tick(*outputs_of(50))
    log.close()
    assert writer.dropped == lost
    read = open_log(tmp_path / "a.mcap")
    ticks = read["/in/tick"]
    kept = len(ticks) - 1
    assert 0 < kept < 50
    assert ticks["sequence"].tolist() == [*range(kept), 50]
    assert ticks["t_us"].tolist() == [*(10_000 * tick for tick in range(kept)), 500_000]
    assert len(read["/nav/state"]) == kept + 1


def test_what_cannot_be_packed_costs_its_tick_and_not_the_log(tmp_path: Path) -> None:
    """The error comes up in the loop, where the guard keeps it."""
    log = RunLog(
        LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH_NS, metadata={}, attachments={}, lossless=True), DESCRIPTION
    )
    recorder = RunRecorder(
        lambda _: log, lambda: (DESCRIPTION, {}), plan_revision=lambda: 0, truth=None, per_arming=False
    )
    good, bad = outputs_of(1), outputs_of(2)
    recorder.record(*good, ())
    object.__setattr__(bad[0], "cpu_load", "none")
    recorder.record(*bad, ())
    while log.writer.queued[0]:
        threading.Event().wait(0.01)
    with pytest.raises(Exception, match="required argument is not a float"):
        recorder.record(*outputs_of(3), ())
    recorder.record(*outputs_of(4), ())
    recorder.close()
    assert recorder.failure is None and recorder.dropped == 0
    assert open_log(tmp_path / "a.mcap")["/in/tick"]["t_us"].tolist() == [10_000, 30_000, 40_000]


def test_the_times_of_a_log_are_by_the_clock_of_its_arming(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A board without a clock of its own has its time set minutes after the service's start."""
    world = HardwareWorld.__new__(HardwareWorld)

    def begin(t_us: int) -> RunLog:
        writer = LogWriter(
            tmp_path / "a.mcap", epoch_ns=world.epoch_ns(t_us), metadata={}, attachments={}, lossless=True
        )
        return RunLog(writer, DESCRIPTION)

    recorder = RunRecorder(begin, lambda: (DESCRIPTION, {}), plan_revision=lambda: 0, truth=None, per_arming=True)
    set_to_ns = 1_790_000_000_000_000_000
    monkeypatch.setattr(time, "time_ns", lambda: set_to_ns)
    recorder.record(*outputs_of(9_000), ())
    recorder.close()
    assert open_log(tmp_path / "a.mcap").epoch_ns + 90_000_000_000 == set_to_ns


def test_an_error_that_nobody_has_taken_is_told_at_the_end(tmp_path: Path) -> None:
    log = RunLog(
        LogWriter(tmp_path / "a.mcap", epoch_ns=EPOCH_NS, metadata={}, attachments={}, lossless=True), DESCRIPTION
    )
    recorder = RunRecorder(
        lambda _: log, lambda: (DESCRIPTION, {}), plan_revision=lambda: 0, truth=None, per_arming=False
    )
    inputs, outputs = outputs_of(1)
    object.__setattr__(inputs, "cpu_load", "none")
    recorder.record(inputs, outputs, ())
    recorder.close()
    assert recorder.failure is not None and "required argument is not a float" in recorder.failure


def test_pictures_are_handed_over_at_their_rate_without_a_copy(tmp_path: Path) -> None:
    from autopilot.core.samples import CameraFrame

    kept = Kept(at_once=False)
    log = RunLog(kept, DESCRIPTION, camera_period_us=200_000)
    pixels = np.full((48, 64, 3), 200, np.uint8)
    inputs, outputs = outputs_of(0)
    for t_us in range(0, 1_000_000, 50_000):
        log.tick(inputs, outputs, [CameraFrame(t_us=t_us, image_bgr=pixels)])
    kept.pack()
    assert [m[1] for m in kept.messages if m[0] == "/in/camera"] == [0, 200_000, 400_000, 600_000, 800_000]
