"""A recorded run through the whole service again: everything that comes out is the same, and what is not is found."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from system_harness import PAPER_PLAN, OpenSession

from autopilot.cli.main import cli
from autopilot.core.errors import LogError
from autopilot.core.messages import Inputs
from autopilot.log.reader import Log, open_log
from autopilot.mavlink.dialect import mav
from autopilot.replay import service_inputs as replay_service
from autopilot.replay.service_replay import replay_service as replayed
from autopilot.run.clocks import LockstepClock
from autopilot.run.config import flight_settings
from autopilot.run.signing_files import SigningFiles
from autopilot.run.sitl_session import open_sitl
from autopilot.run.world import World


@pytest.mark.parametrize(
    ("sensors", "duration_s", "speed"), [("pose", 5.0, 0.0), ("camera", 2.5, 0.0), ("pose", 4.0, 20.0)]
)
def test_a_flight_gives_the_same_bits(
    session: OpenSession, tmp_path: Path, sensors: str, duration_s: float, speed: float
) -> None:
    """In lockstep with pictures and without, and at a speed, where answers come when they are ready."""
    path = tmp_path / "flight.mcap"
    given = {"sensors": sensors, "duration": duration_s, "speed": speed}
    session(plan=str(PAPER_PLAN), start=True, params={"MPC_COST": 1.0}, log=path, **given).run()
    log = open_log(path)
    assert ("/in/markers" in log) == (sensors == "camera")
    result = replayed(log)
    assert result.same, [str(one) for one in result.differences]
    assert result.ticks == round(100 * duration_s)
    assert result.stopped == ""
    assert log.topics["/out/mavlink"].count > 20
    assert log["/out/thrusters"]["thrust_n"].any()


class Signer:
    """A client that signs, every other heartbeat with a key that nobody knows."""

    def __init__(self, key: bytes) -> None:
        self._codecs = []
        for secret in (key, bytes(31) + b"x"):
            codec = mav.MAVLink(None, 255, 190)
            codec.signing.secret_key, codec.signing.sign_outgoing = secret, True
            codec.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)
            self._codecs.append(codec)

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        if t_us % 200_000:
            return []
        codec = self._codecs[t_us // 200_000 % 2]
        return [bytes(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(codec))]


def test_signed_links_replay_without_the_key(session: OpenSession, tmp_path: Path) -> None:
    key, path = bytes(range(1, 33)), tmp_path / "signed.mcap"
    SigningFiles(tmp_path / "state" / "sitl-0").write_key(key)
    session(sensors="pose", duration=2.0, log=path, peers=(Signer(key),)).run()
    log = open_log(path)
    sent = log["/out/mavlink"]
    assert (sent["data"][:, 2] & 1).all()
    result = replayed(log)
    assert result.same, [str(one) for one in result.differences]
    assert result.stopped == ""
    refused = [message.value["msg"] for message in log.messages("/rosout") if "unknown key" in message.value["msg"]]
    assert refused
    assert not any(key in data or key.hex().encode() in data for data in log.attachments.values())


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("replay")
    path = folder / "flown.mcap"
    given = {"scenario": "paper-tank", "speed": 0.0, "sensors": "pose", "start": True, "duration": 3.0}
    settings = flight_settings(folder, {**given, "log": str(path)})
    open_sitl(settings, {}).run()
    return path


def test_one_bit_of_one_input_is_found(flown: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    at_us = 2_000_000
    whole = replay_service.ServiceInputs._whole

    def one_bit_off(self: Any, tick: Any, samples: list[Any], *rest: Any, **more: Any) -> Any:
        for number, sample in enumerate(samples):
            if int(tick["t_us"]) == at_us and hasattr(sample, "rate_frd_rad_s"):
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


def test_only_what_was_compared_is_counted(flown: Path, tmp_path: Path) -> None:
    log = open_log(flown)
    log["/in/tick"]["samples"][150] -= 1
    result = replayed(log, out=tmp_path / "again.mcap")
    assert result.same and "the tick of 1 samples after 1.51 s is missing" in result.stopped
    assert 0 < result.messages <= open_log(tmp_path / "again.mcap").message_count < 0.7 * log.message_count


def test_a_cut_log_replayed_by_the_estimator_alone_is_told(flown: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flown.read_bytes()[:-100])
    done = CliRunner().invoke(cli, ["log", "replay", str(cut), "--only", "estimator"])
    assert done.exit_code == 3 and "cut off" in done.stderr and "replayed is what comes before" in done.stderr


def test_logs_that_cannot_be_replayed_are_named(flown: Path) -> None:
    def without(name: str, data: bytes | None = None) -> Log:
        log = open_log(flown)
        attachments = dict(log.attachments)
        del attachments[name]
        if data is not None:
            attachments[name] = data
        log.contents.attachments.clear()
        log.contents.attachments.update(attachments)
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


def test_ticks_that_a_busy_machine_skipped_at_the_start_are_no_missing_start(
    session: OpenSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock runs while the service is set up: on a small computer the first tick is the eighth."""
    made, path = LockstepClock.now_us, tmp_path / "late.mcap"
    monkeypatch.setattr(LockstepClock, "now_us", lambda self: max(80_000, made(self)))
    monkeypatch.setattr(World, "skips", True)
    session(sensors="pose", duration=1.0, log=path).run()
    log = open_log(path)
    assert log["/in/tick"][0]["t_us"] == 80_000
    result = replayed(log)
    assert result.same and result.stopped == "" and result.ticks == len(log["/in/tick"])


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
