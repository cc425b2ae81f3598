"""State, medium and end: what a vehicle has acknowledged holds after it, and nothing recorded before is obeyed.

The service runs in this process in its own time, on a real folder; a kill is a copy of that folder at that moment.
Killed processes: tests/system/test_restart.py; found armed after one: tests/run/test_disarming_below.py.
"""

from __future__ import annotations

import contextlib
import errno
import re
import shutil
import struct
from pathlib import Path

import pytest
from broken_disks import Disk
from pymavlink.dialects.v20 import development as mav
from test_restart import rally
from wire_client import Harbour, WireClient

from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import FlightMode
from autopilot.mission.paper import paper_plan
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
