"""Files of ground stations through the attitude path: a real one, and gaps of every cause."""

import struct
from pathlib import Path

import pytest
from click.testing import CliRunner
from pymavlink.dialects.v20 import common

from autopilot.cli.log import log
from autopilot.core.errors import LogError
from autopilot.tlog_replay import replay_tlog

REAL = Path(__file__).parents[1] / "data" / "ardusub_log_tools" / "first_12_s.tlog"
BEGIN_US = 1_700_000_000_000_000


class Writer:
    """A sender with its clock and sequence numbers, and the file that its packets end up in."""

    def __init__(self) -> None:
        self.data = b""
        self.boot_ms = 1000
        self._mav = common.MAVLink(None, srcSystem=1, srcComponent=1)

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
    assert found.damaged > 0
    assert len(found.gaps) == 1
    assert "other packets sent instead" in found.gaps[0].reason(found.median_s)
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


def test_a_file_without_attitudes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.tlog"
    path.write_bytes(b"")
    with pytest.raises(LogError, match="holds 0 ATTITUDE messages"):
        replay_tlog(path)
