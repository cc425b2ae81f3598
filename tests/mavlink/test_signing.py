"""Message signing: who is heard, that times are not used twice, and that keys stay where they belong.

Clients sign and check with pymavlink's own code.
"""

from __future__ import annotations

import hashlib
import random
import stat
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from mavlink_harness import MemoryStore, World, mav

from autopilot.cli.main import cli
from autopilot.core.background import BackgroundWorker
from autopilot.core.clients import Reach
from autopilot.core.errors import ConfigError
from autopilot.core.messages import MavlinkFrame
from autopilot.mavlink.api import AHEAD_UNITS, SigningState
from autopilot.mavlink.dialect import extra
from autopilot.mavlink.signing import MAX_STREAMS
from autopilot.run.signing_files import EPOCH_S, SigningFiles

KEY, OTHER = bytes(range(32)), hashlib.sha256(b"other").digest()
NOW_S = EPOCH_S + 370_000_000.0
NOW = 370_000_000 * 100_000
DISARM = (0.0, 21196.0)


class Remote:
    """A client that may sign, with pymavlink's packing; what it gets is checked by pymavlink too."""

    def __init__(self, world: World, key: bytes | None, *, sysid: int = 255, reach: Reach = Reach.NETWORK) -> None:
        self.world, self.reach, self.sysid = world, reach, sysid
        self.mav = mav.MAVLink(None, srcSystem=sysid, srcComponent=190)
        if key is not None:
            self.mav.signing.secret_key, self.mav.signing.sign_outgoing = key, True
            self.mav.signing.timestamp, self.mav.signing.link_id = NOW + 1, 3
        self.mav.robust_parsing = True
        self.raw: list[bytes] = []

    def pack(self, message: Any) -> bytes:
        data = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        return data

    def give(self, data: bytes) -> list[Any]:
        """One tick with that datagram; what the server says."""
        world = self.world
        world.t_us += 10_000
        frame = MavlinkFrame(link=0, client=1 + self.sysid, data=data, reach=self.reach, sender="somebody")
        self.raw = [sent.data for sent in world.server.step(world.t_us, [frame], world.view)]
        return [message for sent in self.raw for message in (self.mav.parse_buffer(sent) or [])]

    def disarm(self) -> None:
        self.give(self.pack(mav.MAVLink_command_long_message(1, 1, 400, 0, *DISARM, 0, 0, 0, 0, 0)))


def calls(world: World) -> list[str]:
    """What the vehicle was told to do."""
    return [call[0] for call in world.vehicle.calls]


def test_without_a_key_unsigned_frames_are_obeyed_and_signed_ones_are_of_a_stranger(world: World) -> None:
    Remote(world, None).disarm()
    assert calls(world) == ["disarm"]
    stranger = Remote(world, OTHER, sysid=66)
    stranger.disarm()
    assert calls(world) == ["disarm"]
    assert "unknown key" in " ".join(event.text for event in world.server.take_notices())


def test_with_a_key_only_its_frames_are_obeyed_and_all_that_goes_out_is_signed() -> None:
    world = World(signing=MemoryStore(KEY, NOW))
    Remote(world, None, sysid=66).disarm()
    Remote(world, None, sysid=66, reach=Reach.MACHINE).disarm()
    Remote(world, OTHER, sysid=66).disarm()
    assert calls(world) == []
    friend = Remote(world, KEY)
    friend.disarm()
    assert calls(world) == ["disarm"]
    for _ in range(300):
        heard = friend.give(b"")
        assert all(data[2] & 1 for data in friend.raw)
        assert len(heard) == len(friend.raw) and not [m for m in heard if m.get_type() == "BAD_DATA"]
    (beat,) = world.server.beat()
    assert friend.mav.check_signature(bytearray(beat.data), 1, 1)
    beats = {world.server.beat()[0].data for _ in range(3)}
    assert len(beats) == 3, "every frame has a time of its own"


def test_events_go_out_signed_and_are_sent_again_to_who_signs() -> None:
    world = World(signing=MemoryStore(KEY, NOW))
    friend, stranger = Remote(world, KEY), Remote(world, None, sysid=66)
    heard = [message.get_type() for _ in range(200) for message in friend.give(b"")]
    assert "EVENT" in heard and "BAD_DATA" not in heard
    ask = extra.MAVLink_request_event_message(1, 1, 1, 2)
    again = friend.give(friend.pack(ask))
    assert [message.sequence for message in again if message.get_type() == "EVENT"] == [1, 2]
    assert all(data[2] & 1 for data in friend.raw)
    assert "EVENT" not in [message.get_type() for message in stranger.give(stranger.pack(ask))]


def test_a_program_of_this_machine_need_not_sign_where_the_operator_says_so() -> None:
    world = World(signing=MemoryStore(KEY, NOW))
    world.params.set("SIGN_LOCAL", 1)
    world.tick()
    Remote(world, None, sysid=66).disarm()
    assert calls(world) == []
    Remote(world, None, sysid=67, reach=Reach.MACHINE).disarm()
    assert calls(world) == ["disarm"]
    Remote(world, OTHER, sysid=68, reach=Reach.MACHINE).disarm()
    assert calls(world) == ["disarm"], "a wrong signature is refused from everywhere"


def test_parts_of_the_service_and_radios_need_no_signature() -> None:
    world = World(signing=MemoryStore(KEY, NOW))
    Remote(world, None, reach=Reach.PROCESS).disarm()
    assert calls(world) == ["disarm"]
    radio = Remote(world, None, sysid=51)
    radio.give(radio.pack(mav.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)))
    assert not world.server.take_notices()


def test_a_key_that_comes_back_does_not_make_recorded_frames_new() -> None:
    """Found by the fuzzer: with a new key the times of all senders were forgotten, and the old one came back."""
    world = World(signing=MemoryStore(KEY, NOW))
    client = Remote(world, KEY)
    recorded = client.pack(mav.MAVLink_command_long_message(1, 1, 400, 0, *DISARM, 0, 0, 0, 0, 0))
    client.give(recorded)
    assert calls(world) == ["disarm"]
    signing = world.server._ctx.signing
    for key in (OTHER, KEY, KEY):
        signing.set_key(key)
        world.server._ctx.key_changed()
        client.give(recorded)
    assert calls(world) == ["disarm"] and signing.refused.old == 2
    client.disarm()
    assert calls(world) == ["disarm"] * 2


class Station(Remote):
    """A ground station whose clock is off by some seconds. ``follows``: its time is never behind what it receives."""

    def __init__(self, world: World, off_s: float, *, follows: bool, sysid: int) -> None:
        super().__init__(world, KEY, sysid=sysid)
        self._off, self._follows = round(off_s * 100_000), follows
        self.sent: list[bytes] = []

    def speak(self, true_s: float) -> None:
        """A disarm command at the true time, kept as somebody on the wire would."""
        clock = round((true_s - EPOCH_S) * 100_000) + self._off
        latest = self.mav.signing.timestamp if self._follows else 0
        self.mav.signing.timestamp = max(clock, latest)
        self.sent.append(self.pack(mav.MAVLink_command_long_message(1, 1, 400, 0, *DISARM, 0, 0, 0, 0, 0)))
        self.give(self.sent[-1])


def run_signed(folder: Path, seconds: float, true_s: float, clock_s: float) -> tuple[World, list[Station]]:
    """A service whose machine's clock stands at ``clock_s`` and four stations that speak every half second."""
    world = World(signing=SigningFiles(folder, BackgroundWorker(), now_s=clock_s))
    stations = [
        Station(world, off_s, follows=follows, sysid=10 + number)
        for number, (off_s, follows) in enumerate(((0.0, False), (0.0, True), (-20.0, True), (45.0, False)))
    ]
    for turn in range(round(2.0 * seconds)):
        for station in stations:
            station.speak(true_s + 0.5 * turn)
        world.run(0.5)
    return world, stations


@pytest.mark.parametrize(
    ("end", "clock_off_s", "run_s"),
    [
        *product(("kill", "orderly"), (0.0, -1e8, -40.0, 3600.0), (0.5, 2.5)),
        ("kill", 0.0, 61.0),  # the time on disk has been renewed many times
        ("orderly", -1e8, 61.0),
    ],
)
def test_no_frame_from_before_a_restart_is_obeyed_after_it(
    tmp_path: Path, end: str, clock_off_s: float, run_s: float
) -> None:
    """Whatever was recorded on the wire, the client's clock ahead or behind, and whatever the clock says then."""
    SigningFiles(tmp_path, now_s=NOW_S).write_key(KEY)
    world, stations = run_signed(tmp_path, run_s, NOW_S + 1.0, NOW_S)
    assert calls(world).count("disarm") > 0
    if end == "orderly":
        world.server.finish()
        world.server._ctx.signing._store.finish()  # type: ignore[union-attr]
    down_s = NOW_S + 1.0 + run_s + 3.0  # what a start takes
    world = World(signing=SigningFiles(tmp_path, BackgroundWorker(), now_s=down_s + clock_off_s))
    for _ in range(3):
        for number, station in enumerate(stations):
            replayed = Remote(world, None, sysid=100 + number)  # on any link
            for data in station.sent:
                replayed.give(data)
        world.run(1.0)
    assert calls(world) == []
    follower = Station(world, -20.0, follows=True, sysid=20)
    follower.give(b"")
    world.run(1.0)
    for _ in range(110):
        follower.give(b"")  # hears a heartbeat at least
    follower.speak(down_s)
    follower.speak(down_s)
    assert calls(world), "who listens goes on, whatever its clock says"


@pytest.mark.parametrize("end", ["kill", "orderly"])
def test_a_client_with_a_right_clock_goes_on_after_a_restart(tmp_path: Path, end: str) -> None:
    """Also one that does not go by what it hears: at once after an orderly end, 2 s after a kill at the latest."""
    SigningFiles(tmp_path, now_s=NOW_S).write_key(KEY)
    world = World(signing=SigningFiles(tmp_path, BackgroundWorker(), now_s=NOW_S))
    station = Station(world, 0.0, follows=False, sysid=10)
    for turn in range(20):
        station.speak(NOW_S + 0.5 * turn + 0.1)
        world.run(0.5)
    assert len(calls(world)) == 20, "none is refused on the way"
    if end == "orderly":
        world.server.finish()
        world.server._ctx.signing._store.finish()  # type: ignore[union-attr]
    begin_s = NOW_S + 10.5 if end == "orderly" else NOW_S + 10.0 + 2.2
    world = World(signing=SigningFiles(tmp_path, BackgroundWorker(), now_s=begin_s))
    station.world = world
    station.speak(begin_s + 0.1)
    assert calls(world) == ["disarm"]


def test_a_client_whose_clock_is_far_ahead_is_heard_once_the_disk_has_its_time(tmp_path: Path) -> None:
    SigningFiles(tmp_path, now_s=NOW_S).write_key(KEY)
    store = SigningFiles(tmp_path, BackgroundWorker(), now_s=NOW_S)
    world = World(signing=store)
    station = Station(world, 600.0, follows=False, sysid=10)
    station.speak(NOW_S)
    assert calls(world) == [], "killed now, its frame would be new again"
    world.run(0.1)
    station.speak(NOW_S + 0.1)
    assert calls(world) == ["disarm"]
    assert SigningFiles(tmp_path, now_s=NOW_S).state.stamp > NOW + 600 * 100_000


def test_a_disk_that_fails_does_not_make_the_vehicle_deaf() -> None:
    store = MemoryStore(KEY, NOW)
    store.failure = "disk full"
    world = World(signing=store)
    station = Station(world, 600.0, follows=False, sysid=10)
    for turn in range(6):
        station.speak(NOW_S + turn)
        world.run(1.0)
    assert len(calls(world)) >= 5
    assert "Signing key or time not saved: disk full" in " ".join(e.text for e in world.server.take_notices())


def test_of_more_senders_than_are_remembered_none_is_heard_twice() -> None:
    world = World(signing=MemoryStore(KEY, NOW))
    first = Remote(world, KEY, sysid=1)
    first.mav.signing.timestamp = NOW + 100
    recorded = first.pack(mav.MAVLink_command_long_message(1, 1, 400, 0, *DISARM, 0, 0, 0, 0, 0))
    first.give(recorded)
    assert calls(world) == ["disarm"]
    crowd = Remote(world, KEY, sysid=200)
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
    for number in range(MAX_STREAMS + 5):
        crowd.mav.signing.link_id, crowd.mav.srcComponent = number % 256, 1 + number // 256
        crowd.give(crowd.pack(beat))
    first.give(recorded)
    assert calls(world) == ["disarm"]


def test_a_damaged_signing_time_is_a_loss_and_nothing_that_was_heard_is_heard_again(tmp_path: Path) -> None:
    SigningFiles(tmp_path, now_s=NOW_S).write_key(KEY)
    world, stations = run_signed(tmp_path, 9.0, NOW_S + 1.0, NOW_S)
    (tmp_path / "signing.time").write_text("nonsense")
    files = SigningFiles(tmp_path, BackgroundWorker(), now_s=0.0)  # and no clock
    assert [loss.text for loss in files.losses] == ["signing time damaged, the machine's clock is in force"]
    world = World(signing=files)
    for number, station in enumerate(stations):
        for data in station.sent:
            Remote(world, None, sysid=100 + number).give(data)
    assert calls(world) == []


def setup(key: bytes = KEY, stamp: int = NOW) -> Any:
    """SETUP_SIGNING."""
    return mav.MAVLink_setup_signing_message(1, 1, list(key), stamp)


def test_a_key_is_taken_from_this_machine_only_and_only_disarmed() -> None:
    world = World(signing=(store := MemoryStore(None, NOW)))
    world.show(armed=False)
    remote = Remote(world, None)
    remote.give(remote.pack(setup()))
    local = Remote(world, None, sysid=254, reach=Reach.MACHINE)
    world.show(armed=True)
    local.give(local.pack(setup()))
    assert store.kept == []
    remote.disarm()
    assert calls(world) == ["disarm"], "unsigned as before"

    world.show(armed=False)
    local.give(local.pack(setup()))
    assert [state.key for state in store.kept] == [KEY] and store.kept[0].stamp >= NOW + AHEAD_UNITS
    remote.disarm()
    local.disarm()
    assert calls(world) == ["disarm"]
    friend = Remote(world, KEY, sysid=7, reach=Reach.MACHINE)
    friend.disarm()
    assert calls(world) == ["disarm", "disarm"]
    local.give(local.pack(setup(OTHER)))  # not signed with the key in force
    assert store.kept[-1].key == KEY
    friend.give(friend.pack(setup(OTHER)))
    assert store.kept[-1].key == OTHER
    other = Remote(world, OTHER, sysid=8, reach=Reach.MACHINE)
    other.mav.signing.timestamp = NOW + 10
    other.give(other.pack(setup(bytes(32), 0)))
    assert store.kept[-1].key is None
    remote.disarm()
    assert calls(world)[-1] == "disarm" and len(calls(world)) == 3


def test_a_key_never_stands_in_a_description(world: World) -> None:
    data = Remote(world, None).pack(setup())
    for frame in (MavlinkFrame(link=0, data=data), MavlinkFrame(link=0, data=b"\xfd\x03junk" + data + data)):
        assert "signing key" in repr(frame) and repr(KEY)[2:20] not in repr(frame)
    assert repr(data)[2:-1] in repr(MavlinkFrame(link=0, data=data[:6]))[0:0] + repr(data)
    assert "aa" * 4 not in repr(SigningState(b"\xaa" * 32, 5))


# On disk


def test_the_key_file_is_its_owners_and_the_time_never_goes_back(tmp_path: Path) -> None:
    files = SigningFiles(tmp_path, now_s=NOW_S)
    assert files.state == SigningState(None, NOW)
    files.write_key(KEY)
    assert stat.S_IMODE((tmp_path / "signing.key").stat().st_mode) == 0o600

    used = 0
    clock_s = NOW_S
    for restart in range(5):
        world = World(signing=SigningFiles(tmp_path, BackgroundWorker(), now_s=clock_s))
        client = Remote(world, KEY)
        client.mav.signing.timestamp = used
        stamps = []
        for _ in range(4500 if restart == 1 else 40):
            client.give(b"")
            stamps += [int.from_bytes(data[-12:-6], "little") for data in client.raw]
        assert min(stamps) > used, "a power cut at any moment: no time is used twice"
        used = max(stamps)
        clock_s = 0.0  # a board without a clock


def test_a_damaged_key_does_not_open_the_vehicle(tmp_path: Path) -> None:
    (tmp_path / "signing.key").write_text("0123")
    with pytest.raises(ConfigError, match="no key of 64 hex digits"):
        SigningFiles(tmp_path)
    (tmp_path / "signing.key").write_text(KEY.hex())
    (tmp_path / "signing.key").chmod(0o644)
    (tmp_path / "signing.time").write_text("nonsense")
    files = SigningFiles(tmp_path, now_s=NOW_S)
    assert files.state == SigningState(KEY, NOW)
    assert [text for text in files.warnings if "read by others" in text] and len(files.warnings) == 2


def test_the_command_makes_shows_and_forgets_a_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AUTOPILOT_STATE_DIR", str(tmp_path))

    def run(*args: str, given: str | None = None) -> str:
        result = CliRunner().invoke(cli, ["mavlink", "key", *args], input=given)
        assert result.exit_code == 0, result.output
        return result.stdout

    assert "no key" in run("show")
    made = run("make", "--instance", "0").splitlines()[0]
    assert SigningFiles(tmp_path / "sitl-0").state.key == bytes.fromhex(made)
    assert run("show").strip() == made
    phrase = hashlib.sha256(b"depth").hexdigest()
    assert phrase in run("make", "--instance", "0", "--passphrase", "--force", given="depth\n")
    assert run("show").strip() == phrase
    run("forget", "--instance", "0")
    assert not (tmp_path / "sitl-0" / "signing.key").exists()


@pytest.mark.parametrize("whose", ["simulation", "vehicle"])
def test_a_key_is_not_replaced_unasked_and_nobody_s_by_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whose: str
) -> None:
    """The real command: a vehicle has to be named, and its key stays unless --force says otherwise."""
    monkeypatch.setenv("AUTOPILOT_STATE_DIR", str(tmp_path))

    def run(*args: str) -> tuple[int, str]:
        result = CliRunner().invoke(cli, ["mavlink", "key", *args])
        return result.exit_code, " ".join(result.output.split())

    def everything() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    for action in ("make", "forget"):
        code, said = run(action)
        assert code == 2 and "--config FILE" in said and "--instance 0" in said and not everything()
    named = ("--instance", "3") if whose == "simulation" else ("--config", "lbv150.toml")
    code, said = run("make", *named)
    (path,) = (path for path in everything() if path.name == "signing.key")
    assert code == 0 and str(path) in said and (f"instance {named[1]}" if whose == "simulation" else named[1]) in said
    before = everything()
    for again in (("make",), ("make", "--passphrase")):
        code, said = run(*again, *named)
        assert code == 2 and "has a key" in said and str(path) in said and "--force" in said
        assert everything() == before
    assert run("make", "--force", *named)[0] == 0 and everything()[path] != before[path]
    path.write_text("0123")
    assert run("make", *named)[0] != 0 and path.read_text() == "0123"
    assert run("make", "--force", *named)[0] == 0
    assert SigningFiles(path.parent).state.key is not None


# MAVLink 1


def old_frames(frames: list[bytes]) -> list[int]:
    """Message numbers of MAVLink 1 frames; all have to be some."""
    assert all(data[0] == 0xFE and len(data) == data[1] + 8 for data in frames)
    return [data[5] for data in frames]


def test_a_mavlink_1_client_is_answered_in_mavlink_1_beside_others() -> None:
    from pymavlink.dialects.v10 import common as v10

    world = World()
    sent: dict[int, list[bytes]] = {5: [], 6: []}

    def exchange(number: int, data: bytes) -> None:
        world.t_us += 10_000
        rx = [MavlinkFrame(link=0, client=number, data=data)] if data else []
        for frame in world.server.step(world.t_us, rx, world.view):
            for client, box in sent.items():
                if frame.client in (0, client) and client not in frame.beside:
                    box.append(frame.data)

    old = v10.MAVLink(None, srcSystem=255, srcComponent=190)
    new = mav.MAVLink(None, srcSystem=254, srcComponent=190)
    exchange(5, old.heartbeat_encode(6, 8, 0, 0, 0).pack(old))
    exchange(6, new.heartbeat_encode(6, 8, 0, 0, 0).pack(new))
    first = sent[5][0]
    assert first[0] == 0xFD and first[7:10] == b"\0\0\0", "once: there is MAVLink 2"
    sent[5].clear()
    sent[6].clear()
    exchange(5, old.param_request_read_encode(1, 1, b"SPD_CRUISE", -1).pack(old))
    exchange(5, old.mission_request_list_encode(1, 1).pack(old))
    exchange(5, old.command_long_encode(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0).pack(old))
    for _ in range(300):
        exchange(5, b"")
    numbers = old_frames(sent[5])
    assert {0, 1, 22, 30, 33, 44, 77, 148} <= set(numbers)
    decoder = v10.MAVLink(None)
    decoded = [message for data in sent[5] for message in (decoder.parse_buffer(data) or [])]
    assert len(decoded) == len(sent[5])
    assert {m.param_id for m in decoded if m.get_type() == "PARAM_VALUE"} == {"SPD_CRUISE"}
    assert all(data[0] == 0xFD for data in sent[6])
    ids = {int.from_bytes(data[7:10], "little") for data in sent[6]}
    assert max(ids) > 255 and not ids & {22, 44}, "telemetry whole, and no answers of the other"

    # A client that goes over to MAVLink 2 gets that from then on.
    new5 = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    exchange(5, new5.heartbeat_encode(6, 8, 0, 0, 0).pack(new5))
    sent[5].clear()
    for _ in range(100):
        exchange(5, b"")
    assert sent[5] and all(data[0] == 0xFD for data in sent[5])


@pytest.mark.parametrize("seed", range(6))
def test_a_client_that_changes_its_version_is_answered_in_the_one_that_it_uses(seed: int) -> None:
    from pymavlink.dialects.v10 import common as v10

    rng, world = random.Random(seed), World()
    codecs = (v10.MAVLink(None, srcSystem=255, srcComponent=190), mav.MAVLink(None, srcSystem=255, srcComponent=190))
    for new in (rng.random() < 0.5 for _ in range(6)):
        codec = codecs[new]
        for beat in range(rng.randint(12, 20)):
            data = bytes(codec.heartbeat_encode(6, 8, 0, 0, 0).pack(codec))
            frames: list[bytes] = []
            for _ in range(100):
                world.t_us += 10_000
                rx = [MavlinkFrame(link=0, client=5, data=data)] if data else []
                sent = world.server.step(world.t_us, rx, world.view)
                frames += [frame.data for frame in sent if frame.client in (0, 5) and 5 not in frame.beside]
                data = b""
            if beat > 0 if new else beat > 11:
                assert {frame[0] for frame in frames} == {0xFD if new else 0xFE}


# Operator control


def test_control_is_taken_asked_for_and_handed_over(world: World) -> None:
    """What nobody else may do meanwhile: tests/service/test_operator_control.py."""
    owner, other = world.client(number=1, sysid=255), world.client(number=2, sysid=66)
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
    assert other.command(400, *DISARM) == 0
    assert owner.command(32100, 1.0, 0.0, 10.0) == 0
    world.vehicle.calls.clear()

    assert other.command(400, *DISARM) == 10
    assert "system 255 is in control" in other.texts()
    assert other.command(185, 1.0) == 10
    assert other.command(300) == 10
    for message in (
        mav.MAVLink_param_set_message(1, 1, b"SPD_CRUISE", 0.2, 9),
        mav.MAVLink_mission_count_message(1, 1, 0, 0),
        mav.MAVLink_mission_clear_all_message(1, 1, 0),
    ):
        other.send(message)
        world.run(0.05)
    assert calls(world) == []
    assert [m.type for m in other.got("MISSION_ACK")] == [mav.MAV_MISSION_DENIED] * 2
    assert [m.error for m in other.got("PARAM_ERROR")] == [3] and other.got("PARAM_VALUE")
    assert other.command(512, 148.0) == 0, "reading goes on"
    status = owner.got("CONTROL_STATUS") or other.got("CONTROL_STATUS")
    assert (status[-1].gcs_main, status[-1].flags) == (255, 1)

    assert other.command(32100, 1.0, 0.0, 10.0) == 4
    (ask,) = [m for m in owner.got("COMMAND_LONG") if m.command == 32100]
    assert (ask.target_system, ask.param1, ask.param3, ask.param4) == (255, 1.0, 10.0, 66.0)
    assert other.command(32100, 0.0) == 10, "nobody gives back what he has not got"
    owner.send(beat)
    assert owner.command(32100, 1.0, 1.0, 10.0) == 0, "may be taken over now"
    assert other.command(32100, 1.0, 0.0, 10.0) == 0
    assert owner.command(400, *DISARM) == 10
    assert other.command(400, *DISARM) == 0
    assert other.command(32100, 0.0) == 0
    assert owner.command(400, *DISARM) == 0


def test_an_operator_who_is_gone_is_not_in_control(world: World) -> None:
    owner, other = world.client(number=1, sysid=255), world.client(number=2, sysid=66)
    assert owner.command(32100, 1.0) == 0
    assert other.command(300) == 10
    world.run(world.params["FS_GCS_TIMEOUT"] + 0.5)
    assert "nobody in control" in other.texts()
    assert (other.got("CONTROL_STATUS")[-1].gcs_main, other.got("CONTROL_STATUS")[-1].flags) == (0, 3)
    assert other.command(300) == 0


def test_a_signed_frame_with_one_bit_turned_is_nobodys() -> None:
    rng = random.Random(3)
    world = World(signing=MemoryStore(KEY, NOW))
    friend = Remote(world, KEY)
    for _ in range(300):
        data = bytearray(friend.pack(mav.MAVLink_command_long_message(1, 1, 400, 0, *DISARM, 0, 0, 0, 0, 0)))
        place = rng.randrange(len(data))
        data[place] ^= 1 << rng.randrange(8)
        if place not in (0, 1):  # else it is half a frame, which waits for the rest
            Remote(world, None, sysid=rng.randrange(1, 250)).give(bytes(data))
    assert calls(world) == []
