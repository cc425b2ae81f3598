"""State, medium and end: what a vehicle has acknowledged holds after it, and nothing recorded before is obeyed.

The service runs in this process in its own time, on a real folder; a kill is a copy of that folder at that moment. The
last test is the process itself.
"""

from __future__ import annotations

import contextlib
import errno
import re
import shutil
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from broken_disks import Disk
from pymavlink.dialects.v20 import development as mav
from test_restart import rally
from wire_client import Harbour, WireClient

from autopilot.bench.live_service import Station
from autopilot.core.errors import LogError
from autopilot.core.plan import PlanKind
from autopilot.log.reader import open_log
from autopilot.mavlink.api import FlightMode
from autopilot.mission.paper import paper_plan
from autopilot.run.children import LOCAL, Child, autopilot_command, free_port
from autopilot.run.config import flight_settings
from autopilot.run.signing_files import EPOCH_S, SigningFiles
from autopilot.run.sitl_session import open_sitl

KEY = bytes(range(40, 72))
NOW_S = EPOCH_S + 370_000_000.0
DOWN_S = 2.5
"""A service is away for so long."""
ARM, REBOOT = 400, 246
ACCEPTED, DENIED = mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED
STATES, ENDS = ("disarmed", "armed", "mission"), ("kill", "terminate", "reboot")
CLOCKS_S = {"clock back": -1e8, "clock forward": 3600.0}
BROKEN = {"full": errno.ENOSPC, "read-only": errno.EROFS, "damaged": 0}
MEDIA = ("fine", *CLOCKS_S, *BROKEN)
CASES = [(STATES[(m + e) % len(STATES)], medium, end) for m, medium in enumerate(MEDIA) for e, end in enumerate(ENDS)]
"""Every two of state, medium and end meet."""
PLAN = paper_plan(laps=500)
PLANS = {PlanKind.FENCE: PLAN.fence, PlanKind.MISSION: PLAN.mission, PlanKind.RALLY: rally()}


class Vehicle(Harbour):
    """A run with a client that signs as pymavlink does."""

    def __init__(self, folder: Path, now_s: float) -> None:
        settings = flight_settings(folder, {"sensors": "pose", "keep_plans": True})
        self.client = WireClient()
        codec = self.client._mav
        codec.signing.secret_key, codec.signing.sign_outgoing, codec.robust_parsing = KEY, True, True
        codec.signing.timestamp = round((now_s - EPOCH_S) * 1e5)
        super().__init__(
            open_sitl(settings, {"MPC_COST": 0.0, "FENCE_REQUIRED": 0.0}, log=False, peers=(self.client,), now_s=now_s)
        )
        self.run(3.0)

    @property
    def armed(self) -> bool:
        return self.session.parts.commander.armed

    def arm(self, value: float = 1.0) -> int:
        return self.command(self.client, ARM, value)

    def signed(self, command: int, *params: float) -> bytes:
        """A command as it goes over the wire."""
        filled = (*params, *(0.0,) * (7 - len(params)))
        return bytes(mav.MAVLink_command_long_message(1, 1, command, 0, *filled).pack(self.client._mav))

    def has_all(self) -> bool:
        parts = self.session.parts
        kept = all(len(parts.plans.items(kind)) == len(items) for kind, items in PLANS.items())
        return kept and parts.params["SPD_CRUISE"] == pytest.approx(0.30)


def copy_if_there(source: str, to: str) -> None:
    """What is being written at that moment has a name of its own, which may be gone by now."""
    with contextlib.suppress(FileNotFoundError):
        shutil.copy2(source, to)


def run_before(folder: Path, state: str, end: str) -> tuple[Path, list[bytes]]:
    """A run that ends in that state; the folder that is left of it and what somebody has recorded."""
    SigningFiles(folder / "sitl-0", now_s=NOW_S).write_key(KEY)
    vehicle = Vehicle(folder, NOW_S)
    for kind, items in PLANS.items():
        assert vehicle.offer(vehicle.client, kind, items) == 0
    vehicle.client.send(mav.MAVLink_param_set_message(1, 1, b"SPD_CRUISE", 0.30, mav.MAV_PARAM_TYPE_REAL32))
    vehicle.until(lambda: any(m.param_id == "SPD_CRUISE" for m in vehicle.client.received("PARAM_VALUE")))
    recorded = [vehicle.signed(ARM, 1.0)]
    vehicle.client.send_bytes(recorded[0])
    vehicle.until(lambda: vehicle.armed)
    if state == "mission":
        recorded.append(vehicle.signed(300))
        vehicle.client.send_bytes(recorded[1])
        vehicle.until(lambda: vehicle.session.parts.commander.mode is FlightMode.MISSION)
        vehicle.run(1.0)
    elif state == "disarmed":
        assert vehicle.arm(0.0) == ACCEPTED
    if end == "kill":
        left = folder.with_name("left")
        shutil.copytree(folder, left, copy_function=copy_if_there)
        vehicle.session.close()
        return left, recorded
    if end == "reboot":
        if state != "disarmed":
            assert vehicle.command(vehicle.client, REBOOT, 1.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED
            assert vehicle.arm(0.0) == ACCEPTED
        assert vehicle.command(vehicle.client, REBOOT, 1.0) == ACCEPTED
        vehicle.until(lambda: vehicle.tick().run_end is not None)
    vehicle.session.close()
    return folder, recorded


Left = dict[tuple[str, str], tuple[Path, list[bytes]]]


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Left:
    """What each run has left, by state and end; every medium begins with a copy."""
    return {
        (state, end): run_before(tmp_path_factory.mktemp(f"{state}-{end}") / "state", state, end)
        for state in STATES
        for end in ENDS
    }


def replay(vehicle: Vehicle, recorded: list[bytes]) -> None:
    for data in recorded:
        vehicle.client.send_bytes(data)
        vehicle.run(0.1)
        assert not vehicle.armed, "a recorded command was obeyed"


@pytest.mark.parametrize(("state", "medium", "end"), CASES)
def test_what_was_acknowledged_holds_after_a_restart(
    left: Left, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, state: str, medium: str, end: str
) -> None:
    kept_then, recorded = left[state, end]
    folder = Path(shutil.copytree(kept_then, tmp_path / "state"))
    kept = folder / "sitl-0"
    disk = Disk(monkeypatch, folder)
    if medium == "damaged":
        for name in ("plans.json", "parameters.params"):
            data = (kept / name).read_bytes()
            (kept / f"{name}.previous").unlink(missing_ok=True)
            (kept / name).write_bytes(data[: len(data) // 2])
    else:
        disk.break_with(BROKEN.get(medium, 0))
    for start in range(2 if medium == "damaged" else 1):  # at the next start nothing is found damaged any more
        vehicle = Vehicle(folder, NOW_S + DOWN_S + start + CLOCKS_S.get(medium, 0.0))
        assert not vehicle.armed and not vehicle.tick().mode.armed
        assert vehicle.has_all() == (medium != "damaged")
        assert vehicle.session.parts.server._ctx.signing.key == KEY
        told = vehicle.client.texts()
        assert any(text.startswith("No arming: ") for text in told) == (medium in BROKEN), told
        replay(vehicle, recorded)
        if medium in BROKEN:
            assert vehicle.arm() == DENIED and not vehicle.armed
            reasons = " ".join(vehicle.client.texts())
            numbers = re.findall(r"STATE_ACCEPT (\d+) accepts", reasons)
            assert numbers, reasons
        if medium != "damaged" or start == 1:
            accept(vehicle, int(numbers[-1]) if medium in BROKEN else 0)
            replay(vehicle, recorded)
            assert vehicle.arm() == ACCEPTED, vehicle.client.texts()
        vehicle.session.close()


def accept(vehicle: Vehicle, number: int) -> None:
    """As an operator does, by PARAM_SET."""
    sent = struct.unpack("<f", struct.pack("<i", number))[0]
    vehicle.client.send(mav.MAVLink_param_set_message(1, 1, b"STATE_ACCEPT", sent, mav.MAV_PARAM_TYPE_INT32))
    vehicle.run(0.1)
    assert vehicle.session.parts.params["STATE_ACCEPT"] == number


# The process


def answered(child: Child, station: Station, codec: Any, ask: Any, wanted: Any) -> Any:
    """The answer to a signed request that is made again and again, its time by the clock."""
    asked_s, begin_s = 0.0, time.monotonic()
    while time.monotonic() - begin_s < 90.0:
        assert child.process.poll() is None
        if time.monotonic() - asked_s > 0.3:
            asked_s = time.monotonic()
            codec.signing.timestamp = round((time.time() - EPOCH_S) * 1e5)
            station.socket.send(ask.pack(codec))
        for message in station.receive(0.05):
            if wanted(message):
                return message
    raise AssertionError("it never came")


@contextlib.contextmanager
def running(folder: Path, name: str) -> Iterator[tuple[Child, Station]]:
    port = free_port()
    common = ("sitl", "open-water", "--quiet", "--sensors", "pose", "--speed", "1", "--keep-plans")
    command = autopilot_command(*common, "--connect", f"udpin:{LOCAL}:{port}", "--log", str(folder / name))
    child = Child(command, {"AUTOPILOT_STATE_DIR": str(folder / "state")})
    try:
        yield child, Station.udp(port, 255)
    finally:
        child.process.kill()
        child.process.wait()


def beats_armed(message: Any) -> bool:
    return message.get_type() == "HEARTBEAT" and bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)


def has_log(path: Path) -> bool:
    """Whether something is on disk that can be read."""
    try:
        return bool(open_log(path).topics)
    except LogError:
        return False


def test_a_recorded_arm_is_not_obeyed_by_the_service_that_comes_after(tmp_path: Path) -> None:
    SigningFiles(tmp_path / "state" / "sitl-0").write_key(KEY)
    codec = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    codec.signing.secret_key, codec.signing.sign_outgoing = KEY, True
    recorded: list[bytes] = []

    class Arm:
        """Every one that is sent is recorded, as by somebody on the wire."""

        def pack(self, sender: Any) -> bytes:
            data = bytes(mav.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0).pack(sender))
            recorded.append(data)
            return data

    with running(tmp_path, "first.mcap") as (child, station):
        answered(child, station, codec, Arm(), beats_armed)
        beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        while not has_log(tmp_path / "first.mcap"):
            answered(child, station, codec, beat, beats_armed)
        child.process.kill()
        child.process.wait(60.0)
    assert open_log(tmp_path / "first.mcap").topics
    with running(tmp_path, "second.mcap") as (child, station):
        check = mav.MAVLink_command_long_message(1, 1, 401, 0, 0, 0, 0, 0, 0, 0, 0)
        done = (ACCEPTED, mav.MAV_RESULT_DENIED)
        answered(child, station, codec, check, lambda m: m.get_type() == "COMMAND_ACK" and m.result in done)
        armed_before = list(recorded)
        beats = 0
        while beats < 4:
            for data in armed_before:
                station.socket.send(data)
            for message in station.receive(0.2):
                assert not beats_armed(message), "a recorded command was obeyed"
                beats += message.get_type() == "HEARTBEAT"
            assert child.process.poll() is None
        answered(child, station, codec, Arm(), beats_armed)
