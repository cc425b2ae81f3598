"""Files of ground stations through the attitude path: a real one, and gaps of every cause."""

import random
import struct
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from autopilot.cli.log import log
from autopilot.cli.main import cli, run
from autopilot.core.errors import LogError
from autopilot.replay.tlog import TlogReplay, replay_tlog

REAL = Path(__file__).parents[1] / "data" / "ardusub_log_tools" / "first_12_s.tlog"
BEGIN_US = 1_700_000_000_000_000


class Writer:
    """A sender with its clock and sequence numbers, and the file that its packets end up in."""

    def __init__(self) -> None:
        self.data = b""
        self.boot_ms = 1000
        self._mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
        self._camera = common.MAVLink(None, srcSystem=1, srcComponent=100)

    def record(self) -> bytes:
        """The next attitude as it would be written, and nothing written."""
        before = self.data
        self.attitude()
        record, self.data = self.data[len(before) :], before
        return record

    def camera(self) -> bytes:
        """A record of another component of the same vehicle."""
        packet = self._camera.heartbeat_encode(30, 0, 0, 0, 0).pack(self._camera)
        return struct.pack(">Q", BEGIN_US + 1000 * self.boot_ms) + packet

    def attitude(self, late_s: float = 0.0, *, lost: bool = False) -> None:
        message = self._mav.attitude_encode(
            self.boot_ms, 0.01, -0.02, 1e-4 * self.boot_ms, 0.0, 1e-6 * self.boot_ms, 0.1
        )
        packet = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        if not lost:
            self.data += struct.pack(">Q", BEGIN_US + 1000 * self.boot_ms + round(1e6 * late_s)) + packet
        self.boot_ms += 50

    def attitudes(self, count: int) -> None:
        for _ in range(count):
            self.attitude()


def test_a_real_vehicles_file_has_no_gap_unexplained() -> None:
    found = replay_tlog(REAL)
    assert found.attitudes > 200
    assert found.median_s == pytest.approx(0.05, abs=0.002)
    assert found.counters["ahrs.good"] == found.attitudes
    assert all(count == 0 for name, count in found.counters.items() if name != "ahrs.good")
    assert found.damaged == {
        f"{name} of component 1/100: checksum wrong (damaged, or of another dialect)": 1
        for name in ("CAMERA_INFORMATION", "VIDEO_STREAM_INFORMATION", "CAMERA_SETTINGS", "CAMERA_CAPTURE_STATUS")
    }
    assert len(found.gaps) == 1
    assert found.gaps[0].reason(found.median_s) == "927 other packets sent instead"  # the camera's are none of its
    assert found.unexplained == []


def test_every_gap_gets_its_cause(tmp_path: Path) -> None:
    writer = Writer()
    writer.attitudes(20)
    for _ in range(6):
        writer.attitude(lost=True)
    writer.attitudes(20)
    writer.attitude(late_s=0.4)
    writer.attitudes(20)
    writer.boot_ms += 500  # the sender says nothing at all
    writer.attitudes(20)
    path = tmp_path / "gaps.tlog"
    path.write_bytes(writer.data)
    found = replay_tlog(path)
    reasons = [gap.reason(found.median_s) for gap in found.gaps]
    assert reasons == ["6 packets lost on the way", "held up on the way: the sender went on evenly", ""]
    assert len(found.unexplained) == 1
    result = CliRunner().invoke(log, ["tlog", str(path)])
    assert result.exit_code == 1
    assert "not explained" in result.output


def replayed(data: bytes, folder: Path) -> TlogReplay:
    path = folder / "made.tlog"
    path.write_bytes(data)
    return replay_tlog(path)


def reasons(found: TlogReplay) -> list[str]:
    return [gap.reason(found.median_s) for gap in found.gaps]


def test_what_comes_twice_or_late_is_no_new_start(tmp_path: Path) -> None:
    writer = Writer()
    writer.attitudes(20)
    writer.data += writer.record() * 2  # over two links
    writer.attitudes(20)
    writer.boot_ms -= 50
    writer.attitude()  # another packet with the stamp of the one before
    writer.attitudes(20)
    first, second = writer.record(), writer.record()
    writer.data += second + first
    writer.attitudes(20)
    writer.boot_ms = 500
    writer.attitudes(20)
    found = replayed(writer.data, tmp_path)
    assert reasons(found) == [
        "the same attitude twice",
        "two attitudes with the same stamp",
        "overtaken on the way by a later one",
        "the sender started anew: its clock went back",
    ]
    assert found.damaged == {}


def test_damaged_pieces_tell_whose_they_were(tmp_path: Path) -> None:
    writer = Writer()
    writer.attitudes(20)
    writer.data += spoilt(writer.record(), 30)
    writer.attitudes(20)
    writer.data += spoilt(writer.camera(), 20)
    writer.data += writer.record()[:25]  # written only in part
    writer.attitudes(20)
    writer.data += bytes(range(200, 250)) * 10
    writer.attitudes(20)
    found = replayed(writer.data, tmp_path)
    assert found.damaged == {
        "ATTITUDE of component 1/1: checksum wrong (damaged, or of another dialect)": 1,
        "HEARTBEAT of component 1/100: checksum wrong (damaged, or of another dialect)": 1,
        "ATTITUDE of component 1/1: damaged": 1,
        "500 bytes that belong to no message": 1,
    }
    assert found.attitudes == 80
    assert found.unexplained == []


def test_a_damaged_length_costs_one_message(tmp_path: Path) -> None:
    """By the damaged length the packet would reach over four records behind it."""
    writer = Writer()
    writer.attitudes(20)
    writer.data += spoilt(writer.record(), 9)
    writer.attitudes(20)
    found = replayed(writer.data, tmp_path)
    assert found.attitudes == 40
    assert found.damaged == {"ATTITUDE of component 1/1: damaged": 1}


def test_random_bytes_get_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "random.tlog"
    for size in (0, 1, 7, 8, 9, 10, 1000, 50_000):
        path.write_bytes(random.Random(size).randbytes(size))
        assert run(lambda: cli(["log", "tlog", str(path)], standalone_mode=False)) != 0
        shown = capsys.readouterr()
        assert shown.out == ""
        assert shown.err.splitlines() == [
            f"error: {path}: holds no MAVLink message; give the .tlog of a ground station"
        ]


def spoilt(record: bytes, place: int) -> bytes:
    """The record with one byte turned over (0 to 7: the stamp, 8: the packet's first byte)."""
    return record[:place] + bytes([record[place] ^ 0xFF]) + record[place + 1 :]


events = st.lists(
    st.one_of(
        st.sampled_from(["sound", "sound", "sound", "twice", "lost", "swapped", "camera", "same stamp"]),
        st.tuples(st.just("spoilt"), st.integers(18, 47)),
        st.tuples(st.just("junk"), st.binary(min_size=1, max_size=60)),
        st.tuples(st.just("cut"), st.integers(1, 47)),
    ),
    min_size=3,
    max_size=30,
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(events=events)
def test_whatever_happens_on_the_way(events: list[str | tuple[str, Any]], tmp_path: Path) -> None:
    """Sound messages all come through, and nothing is taken for a new start of a sender that never stopped."""
    writer = Writer()
    writer.attitudes(3)
    sound, pieces = 3, 0
    for event in events:
        match event:
            case "twice":
                writer.data += writer.record() * 2
                sound += 2
            case "lost":
                writer.attitude(lost=True)
            case "swapped":
                first, second = writer.record(), writer.record()
                writer.data += second + first
                sound += 2
            case "camera":
                writer.data += writer.camera()
            case "same stamp":
                writer.boot_ms -= 50
                writer.attitude()
                sound += 1
            case ("spoilt", int(place)):
                writer.data += spoilt(writer.record(), place)
                pieces += 1
            case ("junk", bytes(junk)):
                writer.data += junk
                pieces += 1
            case ("cut", int(size)):
                writer.data += writer.record()[:size]
                pieces += 1
        if event == "sound" or isinstance(event, tuple):
            writer.attitude()
            sound += 1
    writer.attitudes(3)
    found = replayed(writer.data, tmp_path)
    assert found.attitudes == sound + 3
    assert sum(found.damaged.values()) <= pieces
    assert not any("started anew" in reason for reason in reasons(found))
    assert found.unexplained == []


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**9), flips=st.integers(1, 40))
@example(seed=178, flips=21)
def test_any_damage_is_survived(seed: int, flips: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    writer = Writer()
    writer.attitudes(40)
    data = bytearray(writer.data)
    for _ in range(flips):
        data[rng.randrange(len(data))] = rng.randrange(256)
    found = replayed(bytes(data), tmp_path)
    assert 40 - flips <= found.attitudes <= 40 if flips < 38 else True
    for gap in found.gaps:
        gap.reason(found.median_s)


def test_a_file_without_attitudes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.tlog"
    path.write_bytes(b"")
    with pytest.raises(LogError, match="holds no MAVLink message"):
        replay_tlog(path)


def test_a_file_without_attitudes_tells_how_many(tmp_path: Path) -> None:
    writer = Writer()
    with pytest.raises(LogError, match="holds 0 ATTITUDE messages"):
        replayed(writer.camera() * 3, tmp_path)
