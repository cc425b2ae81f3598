"""Writer thread, queue, session: what was asked to be written is what other readers find."""

import json
import os
import tempfile
import threading
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_synthetic import DESCRIPTION, EPOCH_NS, Run, inputs_at, outputs_at, truth_at, write_run
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from autopilot.core.errors import LogError
from autopilot.core.messages import (
    Authority,
    Event,
    FlightControllerState,
    Inputs,
    LoopStats,
    MavlinkFrame,
    VelocityGoal,
)
from autopilot.core.samples import CameraFrame
from autopilot.log.compare import compare_logs
from autopilot.log.description import from_json
from autopilot.log.log_session import RunLog, log_path, open_run_log
from autopilot.log.packing.records import pack_record
from autopilot.log.reader import open_log
from autopilot.log.topics import TOPICS
from autopilot.log.writer import LogWriter
from autopilot.replay import inputs as replay_inputs


@pytest.fixture(scope="module")
def full_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("log") / "full.mcap", Run(laps=1, full_inputs=True, step_us=100_000))


def contact(t_us: int) -> bytes:
    return pack_record("/sim/contact", EPOCH_NS + t_us * 1000, (t_us, 0.5))


def small(path: Path, **options: object) -> LogWriter:
    return LogWriter(path, epoch_ns=EPOCH_NS, metadata={"version": "1"}, attachments={"a.txt": b"hello"}, **options)  # type: ignore[arg-type]


def test_file_is_what_other_readers_expect(full_log: Path) -> None:
    with full_log.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            assert "offered_qos_profiles" in channel.metadata
            schema = summary.schemas[channel.schema_id]
            assert schema.encoding == "ros2msg" and schema.name.count("/msg/") == 1
        assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
        for _, _, message in reader.iter_messages():
            assert message.log_time == message.publish_time
        attachments = {a.name: a.data for a in reader.iter_attachments()}
        assert from_json(attachments["run.json"], "x") == DESCRIPTION
        (run,) = [m.metadata for m in reader.iter_metadata() if m.name == "run"]
        assert run["epoch_ns"] == str(EPOCH_NS) and run["revision"] == "abc"


def test_every_topic_reads_the_same_with_rosbags(full_log: Path) -> None:
    """rosbags opens the file with the types that it finds there; stamps equal log times; values equal our reader's."""
    store = get_typestore(Stores.EMPTY)
    ours = open_log(full_log)
    seen: dict[str, int] = {}
    with Reader(full_log) as bag:
        for connection in bag.connections:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection, time_ns, raw in bag.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            index = seen.get(connection.topic, 0)
            seen[connection.topic] = index + 1
            stamp = message.header.stamp if hasattr(message, "header") else getattr(message, "stamp", None)
            if stamp is not None:
                assert stamp.sec * 10**9 + stamp.nanosec == time_ns
            if connection.topic == "/nav/state":
                row = ours["/nav/state"][index]
                np.testing.assert_array_equal(message.pos_ned_m, row["pos_ned_m"])
                assert row["t_us"] == (time_ns - EPOCH_NS) // 1000
            elif connection.topic == "/rosout":
                assert message.msg == ours.messages("/rosout")[index].value["msg"]
            elif connection.topic == "/in/markers":
                np.testing.assert_array_equal(message.corners_px, ours["/in/markers"][index]["corners_px"])
    assert seen == {topic: info.count for topic, info in ours.topics.items()}
    assert set(seen) == {*TOPICS, "/nav/aid/markers"}


def test_same_run_gives_the_same_file(tmp_path: Path) -> None:
    first = write_run(tmp_path / "a.mcap", Run(laps=1, step_us=400_000, full_inputs=True))
    second = write_run(tmp_path / "b.mcap", Run(laps=1, step_us=400_000, full_inputs=True))
    assert first.read_bytes() == second.read_bytes()
    assert first.with_suffix(".tlog").read_bytes() == second.with_suffix(".tlog").read_bytes()
    other = write_run(tmp_path / "c.mcap", Run(laps=1, step_us=400_000, full_inputs=True), epoch_ns=EPOCH_NS + 12345000)
    assert compare_logs(open_log(first), open_log(other)) == []


def test_nothing_is_lost_when_the_queue_is_small(tmp_path: Path) -> None:
    with small(tmp_path / "a.mcap", lossless=True, queue_messages=5) as log:
        for t_us in range(3000):
            log.write("/sim/contact", t_us, contact(t_us))
    assert log.dropped == 0
    table = open_log(tmp_path / "a.mcap")["/sim/contact"]
    np.testing.assert_array_equal(table["count"], np.arange(3000))
    np.testing.assert_array_equal(table["sequence"], np.arange(3000))


def test_bytes_limit_holds_too(tmp_path: Path) -> None:
    with small(tmp_path / "a.mcap", lossless=True, queue_bytes=100) as log:
        for t_us in range(200):
            log.write("/sim/contact", t_us, contact(t_us))
    assert len(open_log(tmp_path / "a.mcap")["/sim/contact"]) == 200


def test_a_full_queue_drops_and_counts(tmp_path: Path) -> None:
    """The writer's thread is held up inside a payload; what does not fit meanwhile is dropped and counted."""
    gate, inside = threading.Event(), threading.Event()

    def slow() -> bytes:
        inside.set()
        assert gate.wait(30.0)
        return contact(0)

    log = small(tmp_path / "a.mcap", queue_messages=10)
    log.write("/sim/contact", 0, slow)
    assert inside.wait(30.0)
    for t_us in range(1, 31):
        log.write("/sim/contact", t_us, contact(t_us))
    assert log.dropped == 21
    gate.set()
    log.close()
    sequence = open_log(tmp_path / "a.mcap")["/sim/contact"]["sequence"]
    assert sequence.tolist() == list(range(10))


def test_writing_after_close_counts_as_lost(tmp_path: Path) -> None:
    log = small(tmp_path / "a.mcap", lossless=True)
    log.close()
    log.write("/sim/contact", 0, contact(0))
    log.close()
    assert log.dropped == 1


def test_undeclared_topic_is_refused_at_the_call(tmp_path: Path) -> None:
    with small(tmp_path / "a.mcap") as log, pytest.raises(LogError, match="/no/such"):
        log.write("/no/such", 0, b"")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_full_disk_ends_the_log_and_not_the_run(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    log = small(path, lossless=True, queue_messages=50)
    with open("/dev/full", "wb") as full:
        os.dup2(full.fileno(), log._file.fileno())
    for t_us in range(0, 3_000_000, 1000):
        log.write("/sim/contact", t_us, contact(t_us))
    with pytest.raises(LogError, match="No space left"):
        log.close()
    assert log.failure is not None and log.dropped > 0


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(LogError, match="cannot be written"):
        small(tmp_path / "file" / "a.mcap")
    with pytest.raises(LogError, match="cannot be written"):
        small(tmp_path)
    for epoch_ns in (0, 2**62):
        with pytest.raises(LogError, match="epoch_ns"):
            LogWriter(tmp_path / "a.mcap", epoch_ns=epoch_ns, metadata={}, attachments={})


def test_a_log_in_use_is_not_overwritten(tmp_path: Path) -> None:
    with small(tmp_path / "a.mcap") as log:
        log.write("/sim/contact", 1, contact(1))
        with pytest.raises(LogError, match="another service"):
            small(tmp_path / "a.mcap")
    assert len(open_log(tmp_path / "a.mcap")["/sim/contact"]) == 1
    small(tmp_path / "a.mcap").close()
    assert "/sim/contact" not in open_log(tmp_path / "a.mcap")


def test_tlog_beside_the_log_reads_with_pymavlink(tmp_path: Path) -> None:
    from pymavlink import mavutil
    from pymavlink.dialects.v20 import common

    mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
    log = open_log_for(tmp_path)
    for t_us in range(0, 500_000, 100_000):
        packed = mav.heartbeat_encode(12, 12, 0, 0, 4).pack(mav) + mav.system_time_encode(1, t_us).pack(mav)
        log.inputs(Inputs(t_us=t_us, mavlink_rx=(MavlinkFrame(link=1, data=packed),)))
    key = mav.setup_signing_encode(1, 1, list(range(32)), 0).pack(mav)
    log.inputs(Inputs(t_us=500_000, mavlink_rx=(MavlinkFrame(link=1, data=key),)))
    log.close()
    tlog = tmp_path / "a.tlog"
    connection = mavutil.mavlink_connection(str(tlog))
    kinds = []
    while (message := connection.recv_msg()) is not None:
        kinds.append(message.get_type())
    connection.close()
    assert kinds == ["HEARTBEAT", "SYSTEM_TIME"] * 5
    frames = open_log(tmp_path / "a.mcap")["/in/mavlink"]
    assert len(frames) == 10 and set(frames["link"]) == {1}
    secret = bytes(range(32))
    assert secret not in tlog.read_bytes()
    assert all(secret not in row.tobytes() for row in frames["data"])


def open_log_for(folder: Path) -> RunLog:
    return open_run_log(
        folder / "a.mcap",
        epoch_ns=EPOCH_NS,
        description=DESCRIPTION,
        metadata={},
        attachments={},
        lossless=True,
        camera_period_us=200_000,
    )


def test_camera_images_come_at_their_rate(tmp_path: Path) -> None:
    import cv2

    log = open_log_for(tmp_path)
    pixels = np.full((48, 64, 3), 200, np.uint8)
    for t_us in range(0, 1_000_000, 33_000):
        log.camera(CameraFrame(t_us=t_us, image_bgr=pixels))
    log.close()
    images = open_log(tmp_path / "a.mcap").messages("/in/camera")
    assert [m.t_us for m in images] == [0, 231_000, 462_000, 693_000, 924_000]
    picture = cv2.imdecode(np.frombuffer(images[0].value["data"], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None and picture.shape == (48, 64, 3) and abs(int(picture.mean()) - 200) < 3


def test_rates_and_changes(tmp_path: Path) -> None:
    """Slow state is written once per second and at every change; the order of inputs is kept."""
    log = open_log_for(tmp_path)
    run = Run()
    for t_us in range(0, 3_000_001, 10_000):
        truth = truth_at(t_us * 1e-6)
        log.truth(t_us, truth)
        log.contact(t_us, int(t_us >= 1_500_000), 0.0)
        log.inputs(inputs_at(t_us, truth))
        outputs = outputs_at(t_us, truth, run)
        log.outputs(outputs)
    log.loop(LoopStats(t_us=3_000_000, tick_s=0.01, cpu_s=0.5, overruns=1, dropped_log=0))
    log.event(Event(t_us=3_000_000, severity=2, text="leak"))
    log.close()
    read = open_log(tmp_path / "a.mcap")
    assert read["/sim/contact"]["t_us"].tolist() == [0, 1_000_000, 1_500_000, 2_500_000]
    assert read["/sys/mode"]["t_us"].tolist() == [0, 1_000_000, 2_000_000, 3_000_000]
    counts = {topic: read.topics[topic].count for topic in read.topics}
    assert counts["/sim/truth"] == counts["/nav/state"] == counts["/in/tick"] == counts["/in/ahrs_raw"] == 301
    assert counts["/nav/covariance"] == counts["/ctl/horizon"] == counts["/ctl/tube"] == counts["/viz/truth"] == 31
    assert counts["/viz/tf"] == 62
    assert counts["/viz/markers"] == 4
    assert read.messages("/rosout")[-1].value["level"] == 50
    assert read["/in/tick"]["samples"][0] == 16 and read["/in/tick"]["frames"][0] == 1
    assert read["/in/ahrs_raw"]["t_us"][3] == 30_000 - 15_000
    assert json.loads(read.attachments["run.json"])["scenario"] == "paper-tank"


def test_the_last_description_counts(tmp_path: Path) -> None:
    log = open_log_for(tmp_path)
    later = replace(DESCRIPTION, scenario="later", obstacles=())
    for t_us in range(0, 3_000_000, 100_000):
        if t_us == 1_500_000:
            log.describe(t_us, later, {"plans.json": str(t_us).encode()})
        log.outputs(outputs_at(t_us, truth_at(t_us * 1e-6), Run()))
    log.close()
    read = open_log(tmp_path / "a.mcap")
    assert read.description == later and read.verify() == ()
    marks = [len(m.value["markers"]) for m in read.messages("/viz/markers")]
    assert marks[0] == marks[1] == marks[2] + 4
    with (tmp_path / "a.mcap").open("rb") as file:
        assert [a.name for a in make_reader(file).iter_attachments()] == ["run.json", "run.json", "plans.json"]


def test_names_by_start_time(tmp_path: Path) -> None:
    first = log_path(tmp_path, EPOCH_NS)
    assert first == tmp_path / "2023-11-14" / "22_13_20.mcap"
    first.parent.mkdir()
    first.touch()
    second = log_path(tmp_path, EPOCH_NS)
    assert second.name == "22_13_20_2.mcap"
    second.touch()
    assert log_path(tmp_path, EPOCH_NS).name == "22_13_20_3.mcap"


texts = st.text(max_size=40).filter(lambda text: len(text.encode(errors="replace")) <= 64)
"""That fit into their field."""
speeds = st.floats(-3.0, 3.0)
belows = st.builds(
    FlightControllerState,
    t_us=st.just(0),
    authority=st.sampled_from(Authority),
    acts=st.booleans(),
    text=texts,
    problem=texts,
    refusals=st.lists(texts.filter(bool), max_size=4).map(tuple),
    pulses_us=st.lists(st.integers(0, 0xFFFF), max_size=8).map(tuple),
    armed=st.sampled_from((False, True, None)),
    rival=st.booleans(),
)
drives = st.none() | st.builds(
    VelocityGoal,
    north_m_s=speeds,
    east_m_s=speeds,
    turn_rad_s=speeds,
    down_m_s=st.none() | speeds,
    yaw_rate_rad_s=st.none() | speeds,
    yaw_trend_rad_s=speeds,
)


@given(given_below=st.lists(belows, min_size=1, max_size=8), given_drive=st.lists(drives, min_size=1, max_size=8))
@settings(max_examples=10, deadline=None)
def test_what_the_vehicle_below_says_and_what_a_pilot_asks_for_stand_in_the_log_tick_by_tick(
    given_below: list[FlightControllerState], given_drive: list[VelocityGoal | None]
) -> None:
    """Written when they change: what holds at each tick is the last before it, equal in every field that fits."""
    pieces = zip_longest(given_below, given_drive, fillvalue=None)
    told = [(below or given_below[-1], drive) for below, drive in pieces]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        log = open_run_log(path, epoch_ns=EPOCH_NS, description=DESCRIPTION, metadata={}, attachments={}, lossless=True)
        for tick, (below, drive) in enumerate(told):
            t_us = 10_000 * tick
            outputs = outputs_at(t_us, truth_at(0.0), Run())
            assert outputs.goal is not None
            log.inputs(Inputs(t_us=t_us, below=replace(below, t_us=t_us)))
            log.outputs(replace(outputs, goal=replace(outputs.goal, drive=drive)))
        log.close()
        read = open_log(path)
        belows_read = [replay_inputs.below(row) for row in read["/in/below"]]
        drives_read = (
            [(int(row["t_us"]), replay_inputs.drive(row)) for row in read["/ctl/drive"]] if "/ctl/drive" in read else []
        )
    for tick, (below, drive) in enumerate(told):
        (now,) = [said for said in belows_read if said.t_us <= 10_000 * tick][-1:]
        kept = (now.authority, now.acts, now.pulses_us, now.text, now.problem)
        assert kept == (below.authority, below.acts, below.pulses_us, plain(below.text), plain(below.problem))
        assert (now.armed, now.rival) == (below.armed, below.rival)
        assert now.refusals == tuple("".join(f"{plain(line)}\n" for line in below.refusals).splitlines())
        assert ([None, *(said for t_us, said in drives_read if t_us <= 10_000 * tick)])[-1] == drive


def plain(text: str) -> str:
    """As UTF-8 and a field with zeros behind it give it back."""
    return text.encode(errors="replace").decode().rstrip("\0")


def test_long_texts_of_the_vehicle_below_are_cut_between_characters() -> None:
    for padding in range(4):
        said = FlightControllerState(t_us=0, authority=Authority.STOPPED, acts=False, text="x" * padding + "é" * 60)
        assert b"x" * padding + "é".encode() * ((64 - padding) // 2) in pack_record("/in/below", 0, said)
