"""A recorded run through the whole service again: everything that comes out is the same, and what is not is found."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from system_harness import PAPER_PLAN, OpenSession

from autopilot.cli.main import cli
from autopilot.core.errors import LogError
from autopilot.core.messages import Inputs
from autopilot.log import replay_service
from autopilot.log.reader import Log, open_log
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_replay import replay_service as replayed
from autopilot.run.sitl_session import open_sitl


@pytest.mark.parametrize(("sensors", "duration_s"), [("pose", 5.0), ("camera", 2.5)])
def test_a_flight_gives_the_same_bits(session: OpenSession, tmp_path: Path, sensors: str, duration_s: float) -> None:
    path = tmp_path / "flight.mcap"
    session(sensors=sensors, plan=str(PAPER_PLAN), start=True, duration=duration_s, log=path).run()
    log = open_log(path)
    assert ("/in/markers" in log) == (sensors == "camera")
    result = replayed(log)
    assert result.same, [str(one) for one in result.differences]
    assert result.ticks == round(100 * duration_s)
    assert result.stopped == ""
    assert log.topics["/out/mavlink"].count > 20
    assert log["/out/thrusters"]["thrust_n"].any()


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("replay")
    path = folder / "flown.mcap"
    given = {"scenario": "paper-tank", "speed": 0.0, "sensors": "pose", "start": True, "duration": 3.0}
    settings = gather(sitl_defaults(0), given, {})
    for name, value in (("connect", ()), ("state_dir", str(folder)), ("log", str(path))):
        settings.put(name, value, "test")
    open_sitl(settings, {}).run()
    return path


def test_one_bit_of_one_input_is_found(flown: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    at_us = 2_000_000
    whole = replay_service.ServiceInputs._whole

    def one_bit_off(self: Any, tick: Any, samples: list[Any], *rest: Any, **more: Any) -> Any:
        for number, sample in enumerate(samples):
            if sample.t_us == at_us and hasattr(sample, "rate_frd_rad_s"):
                rate = sample.rate_frd_rad_s.copy()
                rate[2] += 1e-9
                samples[number] = replace(sample, rate_frd_rad_s=rate)
        return (yield from whole(self, tick, samples, *rest, **more))

    monkeypatch.setattr(replay_service.ServiceInputs, "_whole", one_bit_off)
    result = replayed(open_log(flown))
    first = next(one for one in result.differences if not one.topic.startswith("/in/"))
    assert first.topic.startswith("/nav/")
    assert first.t_s == pytest.approx(2.0, abs=0.02)
    assert " against " in first.what


def test_all_inputs_come_back(flown: Path) -> None:
    given: list[Inputs] = list(replay_service.ServiceInputs(open_log(flown)))
    assert [inputs.t_us for inputs in given] == list(range(10_000, 3_000_001, 10_000))
    assert sum(len(inputs.mavlink_rx) for inputs in given) > 3


def test_command(flown: Path) -> None:
    done = CliRunner().invoke(cli, ["log", "replay", str(flown)])
    assert done.exit_code == 0, done.output
    assert "300 ticks" in done.output and "all the same" in done.output


def test_a_log_that_breaks_off_is_replayed_until_there(flown: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flown.read_bytes()[: int(0.6 * flown.stat().st_size)])
    done = CliRunner().invoke(cli, ["log", "replay", str(cut)])
    assert done.exit_code in (1, 3), done.output
    if done.exit_code == 1:
        assert "service.json" in str(done.exception or done.output)


def test_logs_that_cannot_be_replayed_are_named(flown: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty.mcap"
    empty.write_bytes(b"")
    foreign = tmp_path / "foreign.mcap"
    foreign.write_bytes(b"\x89PNG\r\n" + bytes(500))
    for path in (empty, foreign, tmp_path / "none.mcap"):
        with pytest.raises(LogError, match=path.name):
            replayed(open_log(path))

    def without(name: str, data: bytes | None = None) -> Log:
        log = open_log(flown)
        attachments = dict(log.attachments)
        del attachments[name]
        if data is not None:
            attachments[name] = data
        log._contents.attachments.clear()
        log._contents.attachments.update(attachments)
        return log

    for name in ("service.json", "start_plans.json", "vehicle.json", "estimator.json"):
        with pytest.raises(LogError, match=name):
            replayed(without(name))
    with pytest.raises(LogError, match="format 99, this version reads 1"):
        replayed(without("service.json", b'{"format": 99, "news": true}'))
    with pytest.raises(LogError, match=r"service\.json"):
        replayed(without("service.json", b'{"format": 1}'))
    with pytest.raises(LogError, match=r"service\.json"):
        replayed(without("service.json", b"{"))


def test_time_that_goes_back_and_ticks_that_are_missing(flown: Path) -> None:
    log = open_log(flown)
    log["/in/tick"]["t_us"][200] = log["/in/tick"]["t_us"][100]
    result = replayed(log)
    assert result.ticks == 200
    assert result.stopped == "time goes back from 2.00 s to 1.01 s"
    log = open_log(flown)
    log["/in/tick"]["samples"][150] += 2
    result = replayed(log)
    assert result.ticks == 150
    assert "2 of the samples at 1.51 s" in result.stopped
    log = open_log(flown)
    log["/in/tick"]["t_us"] += 1_000_000
    with pytest.raises(LogError, match="already running"):
        replayed(log)
