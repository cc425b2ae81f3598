"""A recorded flight through the estimator again: the same in every bit, and what another setting would have given."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from system_harness import PAPER_PLAN, OpenSession

from autopilot.cli.main import cli
from autopilot.core.errors import ConfigError, LogError
from autopilot.log.reader import Log, open_log
from autopilot.record.estimator_setup import read_markers, read_setup
from autopilot.replay.estimator_replay import matches, replay, replay_setup, spreads, write_replay


def _flown(session: OpenSession, path: Path, sensors: str, duration_s: float) -> Log:
    session(sensors=sensors, plan=str(PAPER_PLAN), start=True, duration=duration_s, log=path).run()
    return open_log(path)


@pytest.mark.parametrize(("sensors", "duration_s"), [("pose", 6.0), ("camera", 3.0)])
def test_a_recorded_flight_gives_the_same_bits(
    session: OpenSession, tmp_path: Path, sensors: str, duration_s: float
) -> None:
    log = _flown(session, tmp_path / "flight.mcap", sensors, duration_s)
    assert ("/in/markers" in log) == (sensors == "camera")
    assert float(np.abs(log["/nav/thrust"]["thrust_n"]).max()) > 1.0
    states = replay(log, read_setup(log))
    found = matches(log, states)
    assert [match.topic for match in found if not match.same] == []
    assert found[0].identical > 60.0 * (duration_s - 1.5)

    # One bit of one field is seen.
    middle = len(states) // 2
    pos_ned_m = states[middle].pos_ned_m.copy()
    pos_ned_m[1] = np.nextafter(pos_ned_m[1], np.inf)
    states[middle] = replace(states[middle], pos_ned_m=pos_ned_m)
    off = matches(log, states)[0]
    assert off.identical == off.logged - 1
    assert "pos_ned_m" in off.first

    if sensors == "camera":
        markers = read_markers(log.attachments)
        assert markers is not None
        assert markers.level
        return
    result = CliRunner().invoke(cli, ["log", "replay", "--only", "estimator", str(log.path)])
    assert result.exit_code == 0, result.output
    assert f"{found[0].logged} of {found[0].logged} messages identical" in result.output

    setup = replay_setup(log, "complementary", ["model_aid=false"])
    other = replay(log, setup)
    assert not matches(log, other)[0].same
    by_name = {row.quantity: row for row in spreads(log, other)}
    assert 1e-5 < by_name["position"].difference < 0.2
    assert by_name["position"].logged_error is not None
    assert by_name["position"].logged_error < 0.02

    again = open_log(write_replay(tmp_path / "replayed.mcap", log, states))
    assert len(again["/nav/state"]) == len(states)
    text = write_replay(tmp_path / "replayed.csv", log, other).read_text().splitlines()
    assert len(text) == len(other) + 1
    assert float(text[1].split(",")[1]) == other[0].pos_ned_m[0]
    with pytest.raises(LogError, match="neither"):
        write_replay(tmp_path / "replayed.txt", log, states)
    with pytest.raises(ConfigError, match="model_aid"):
        replay_setup(log, None, ["model_aids=1"])
    with pytest.raises(ConfigError, match="maybe"):
        replay_setup(log, None, ["model_aid=maybe"])

    # A log that begins late, or lacks an input, cannot give the same.
    ticks = log["/in/tick"]
    ticks["samples"][30] += 1
    with pytest.raises(LogError, match="1 of the inputs"):
        replay(log, setup)
    extra = int(ticks["samples"][30]) - 1
    ticks["samples"][30] = 0
    with pytest.raises(LogError, match=f"the tick of {extra} inputs after 0.31 s is missing"):
        replay(log, setup)
    ticks["t_us"] += 1_000_000
    with pytest.raises(LogError, match="already running"):
        replay(log, setup)


def test_a_wide_view_replays_too(session: OpenSession, tmp_path: Path) -> None:
    """The BlueROV2's camera sees twice as many markers as a logged sighting holds."""
    log_file = tmp_path / "wide.mcap"
    session(vehicle="bluerov2", sensors="camera", plan=str(PAPER_PLAN), start=True, duration=1.2, log=log_file).run()
    log = open_log(log_file)
    sightings = log["/in/markers"]
    last = sightings[-1]
    assert last["count"] > 50
    middles = last["corners_px"][: 8 * last["count"]].reshape(-1, 4, 2).mean(axis=1)
    assert (np.ptp(middles, axis=0) > [250.0, 180.0]).all()
    states = replay(log, read_setup(log))
    assert len(states) > 40
    assert [match.topic for match in matches(log, states) if not match.same] == []
