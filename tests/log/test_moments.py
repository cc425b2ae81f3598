"""Any moment of a log: what the tables say, without reading the file, also of broken and foreign files."""

import json
from pathlib import Path

import numpy as np
import pytest
from log_synthetic import Run, write_run
from mcap.writer import CompressionType, Writer

from autopilot.core.errors import LogError
from autopilot.core.vehicle import load_vehicle
from autopilot.log import moments
from autopilot.log.container import Damage, unpack
from autopilot.log.moments import LogMoments
from autopilot.log.reader import open_log
from autopilot.view.log_frames import LogFrames

TOPICS = ("/nav/state", "/nav/covariance", "/sim/truth", "/out/thrusters", "/ctl/goal", "/sys/mode", "/in/power_raw")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("moments") / "sound.mcap", Run(laps=1, step_us=500_000))


def same_as_tables(path: Path) -> int:
    """How many moments agree with the tables of the same file."""
    log = open_log(path)
    made, count = LogMoments(log), 0
    begin_us, end_us = made.span_us
    for topic in (topic for topic in TOPICS if topic in log):
        table = log[topic]
        for t_us in np.linspace(begin_us - 1, end_us + 1, 57).astype(int).tolist():
            earlier = table[table["t_us"] <= t_us]
            found = made.latest(topic, t_us)
            assert (found is None) == (not len(earlier)), (topic, t_us)
            if found is None:
                continue
            row = earlier[np.argsort(earlier["t_us"], kind="stable")][-1]
            assert found["t_us"] == row["t_us"]
            for name in (table.dtype.names or ())[2:]:
                np.testing.assert_array_equal(found[name], row[name], err_msg=f"{topic} {name}")
            count += 1
    return count


def test_a_moment_is_the_last_message_of_each_topic(sound: Path) -> None:
    assert same_as_tables(sound) > 200


def test_only_what_a_moment_needs_is_unpacked(sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked = []

    def counted(file: object, chunk: object) -> bytes:
        unpacked.append(chunk)
        return unpack(file, chunk)  # type: ignore[arg-type]

    monkeypatch.setattr(moments, "unpack", counted)
    monkeypatch.setattr(moments, "KEPT_CHUNKS", 4)
    log = open_log(sound)
    made = LogMoments(log)
    assert unpacked == [] and len(log.contents.chunks) > 20
    middle_us = sum(made.span_us) // 2
    unpacked.clear()
    assert made.latest("/nav/state", middle_us) is not None
    assert made.latest("/sim/truth", middle_us) is not None
    assert len(unpacked) <= 2
    for t_us in np.linspace(*made.span_us, 40).astype(int).tolist():
        made.latest("/nav/state", t_us)
        assert len(made._kept) <= 4


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_a_log_that_is_cut_off(sound: Path, tmp_path: Path, share: float) -> None:
    path = tmp_path / "cut.mcap"
    data = sound.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    assert same_as_tables(path) > 30
    log = open_log(path)
    frames = LogFrames(log, load_vehicle("lbv150"))
    about = frames.about()
    whole = LogFrames(open_log(sound), load_vehicle("lbv150")).about()
    assert about.begin_s == whole.begin_s and about.end_s < whole.end_s
    assert any("cut off" in line for line in about.scene.steerable.missing)
    assert frames.frame(about.end_s).estimate is not None


def test_a_log_with_a_damaged_chunk(sound: Path, tmp_path: Path) -> None:
    """What was in it is as if it had never been; frames there are of the last moment before."""
    log = open_log(sound)
    chunk = log.contents.chunks[len(log.contents.chunks) // 2]
    data = bytearray(sound.read_bytes())
    middle = chunk.offset + chunk.length // 2
    data[middle : middle + 40] = bytes(40)
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    with path.open("rb") as file, pytest.raises(Damage):
        unpack(file, chunk)
    frames = LogFrames(open_log(path), load_vehicle("lbv150"))
    about = frames.about()
    shown = [frames.frame(t_s) for t_s in np.linspace(about.begin_s, about.end_s, 80)]
    assert all(frame.estimate is not None for frame in shown[5:])
    assert same_as_tables(path) > 200


def test_a_log_of_another_program(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, use_chunking=False)
        writer.start()
        schema = writer.register_schema("thing", "jsonschema", b"{}")
        channel = writer.register_channel("/nav/state", "json", schema)
        for k in range(5):
            writer.add_message(channel, 10**9 * k, json.dumps({"k": k}).encode(), 10**9 * k)
        writer.finish()
    frames = LogFrames(open_log(path), load_vehicle("lbv150"))
    frame = frames.frame(2.0)
    assert frame.estimate is None and frame.mode == "0" and frames.about().events == ()


def test_an_empty_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(LogError, match="has no messages; give a log of a run"):
        LogFrames(open_log(path), load_vehicle("lbv150"))


def test_frames_hold_what_the_log_holds(tmp_path: Path) -> None:
    """Estimate, truth, goal, controller, thrusters, events at their times; the past of a value as its age."""
    log = open_log(write_run(tmp_path / "full.mcap", Run(laps=1, step_us=500_000, full_inputs=True)))
    frames = LogFrames(log, load_vehicle("lbv150"))
    about = frames.about()
    assert [event.text for event in about.events] == [str(m.value["msg"]) for m in log.messages("/rosout")]
    t_s = 0.5 * (about.begin_s + about.end_s)
    frame = frames.frame(t_s)
    assert frame.estimate is not None and frame.truth is not None and frame.goal is not None
    table = log["/nav/state"]
    row = table[table["t_us"] <= round(1e6 * t_s)][-1]
    assert frame.estimate.pos_ned_m == pytest.approx(row["pos_ned_m"], abs=1e-4)
    command = log["/out/thrusters"]
    assert frame.thrust_n == pytest.approx(command[command["t_us"] <= round(1e6 * t_s)][-1]["thrust_n"][:4], abs=1e-4)
    assert frame.control is not None and len(frame.control.horizon_ned_m) > 2
    assert frame.control.tube_m == pytest.approx(np.linspace(0.02, 0.06, 5), abs=1e-4)
    assert 0 <= frame.control.age_s < 2 and frame.battery is not None and len(frame.solids) == 2
    goal = log["/ctl/goal"]
    assert frame.goal.pos_ned_m == pytest.approx(goal[goal["t_us"] <= round(1e6 * t_s)][-1]["pos_ned_m"], abs=1e-4)
    picture = frames.picture(t_s)
    assert picture is not None and picture.t_s <= t_s and picture.width_px > 0
    answer = frames.frames(t_s, t_s + 1.0, 0.25)
    assert [round(one.t_s - t_s, 6) for one in answer.frames] == [0, 0.25, 0.5, 0.75, 1.0]
