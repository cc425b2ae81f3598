"""What earlier runs have kept cannot be read, or nothing can be kept: that is said, and accepted before arming."""

from __future__ import annotations

import errno
import shutil
import struct
from pathlib import Path

import pytest
from broken_disks import Disk
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession, sessions
from wire_client import Harbour, WireClient

from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan

ARM = (400, 1.0)
DENIED, ACCEPTED = mav.MAV_RESULT_DENIED, mav.MAV_RESULT_ACCEPTED
FILES = {"parameters": "parameters.params", "plans": "plans.json"}


class Vehicle(Harbour):
    """A run of the vehicle with a client."""

    def __init__(self, session: OpenSession) -> None:
        self.client = WireClient()
        super().__init__(session(sensors="pose", keep_plans=True, peers=(self.client,), params={"FENCE_REQUIRED": 0.0}))
        self.client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        self.run(3.0)
        self.greeted = self.client.texts()

    def set_param(self, name: str, value: float, *, whole: bool = False) -> None:
        spec = self.session.parts.params.spec(name)
        assert spec.minimum <= value <= spec.maximum
        kind = mav.MAV_PARAM_TYPE_INT32 if whole else mav.MAV_PARAM_TYPE_REAL32
        sent = struct.unpack("<f", struct.pack("<i", int(value)))[0] if whole else value
        self.client.send(mav.MAVLink_param_set_message(1, 1, name.encode(), sent, kind))
        self.run(0.2)
        assert self.session.parts.params[name] == pytest.approx(value)

    def arm(self) -> int:
        return self.command(self.client, *ARM)

    def reasons(self) -> str:
        return " ".join(self.client.texts())


@pytest.fixture(scope="module")
def kept_state(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run has left that has kept parameters (twice) and plans, and ended in an orderly way."""
    folder = tmp_path_factory.mktemp("prepared")
    with sessions(folder) as session:
        _keep(Vehicle(session))
    return folder / "state"


@pytest.fixture
def prepared(kept_state: Path, tmp_path: Path) -> Path:
    """A copy of it, in which the test's own runs begin."""
    return Path(shutil.copytree(kept_state, tmp_path / "state"))


def _keep(vehicle: Vehicle) -> None:
    plan = paper_plan()
    assert vehicle.offer(vehicle.client, PlanKind.MISSION, plan.mission) == 0
    assert vehicle.offer(vehicle.client, PlanKind.FENCE, plan.fence) == 0
    vehicle.set_param("SPD_CRUISE", 0.31)
    vehicle.set_param("SPD_CRUISE", 0.30)
    assert vehicle.arm() == ACCEPTED, vehicle.reasons()
    assert vehicle.command(vehicle.client, 400, 0.0) == ACCEPTED
    vehicle.session.close()


def has_all(vehicle: Vehicle) -> bool:
    plans = vehicle.session.parts.plans
    kept = all(plans.items(kind) for kind in (PlanKind.MISSION, PlanKind.FENCE))
    return kept and vehicle.session.parts.params["SPD_CRUISE"] == pytest.approx(0.30)


@pytest.mark.parametrize(("error", "named"), [(errno.EROFS, "disk read-only"), (errno.ENOSPC, "disk full")])
@pytest.mark.usefixtures("prepared")
def test_a_disk_that_takes_no_writes_is_read_and_arms_only_when_accepted(
    session: OpenSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int, named: str
) -> None:
    disk = Disk(monkeypatch, tmp_path / "state")
    disk.break_with(error)
    vehicle = Vehicle(session)
    assert has_all(vehicle), "what can be read is in force"
    assert any(named in text for text in vehicle.greeted), vehicle.greeted
    late = WireClient(sysid=254)
    vehicle.client.inbox.clear()
    late.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    vehicle.client.send_bytes(late.step(0, ())[0])
    vehicle.until(lambda: "No arming" in vehicle.reasons(), 60.0)
    assert f"({named}): STATE_ACCEPT 1 accepts it" in vehicle.reasons(), "who comes later is told as well"
    assert vehicle.arm() == DENIED and named in vehicle.reasons()
    vehicle.set_param("STATE_ACCEPT", 1, whole=True)
    assert vehicle.arm() == ACCEPTED, vehicle.reasons()
    vehicle.session.close()
    vehicle = Vehicle(session)
    assert vehicle.arm() == DENIED, "accepted for one run"
    disk.break_with(0)
    vehicle.run(6.0)
    assert vehicle.arm() == ACCEPTED, "a disk that is sound again needs no acceptance"


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("damage", ["cut", "bent", "emptied", "folder"])
@pytest.mark.usefixtures("prepared")
def test_a_damaged_file_keeps_the_vehicle_disarmed_until_it_is_accepted(
    session: OpenSession, tmp_path: Path, kind: str, damage: str
) -> None:
    """At this start and at the next one, though nothing is left to be found damaged then."""
    path = tmp_path / "state" / "sitl-0" / FILES[kind]
    data = path.read_bytes()
    previous = path.with_name(path.name + ".previous")
    previous.unlink(missing_ok=True)
    path.unlink()
    match damage:
        case "cut":
            path.write_bytes(data[: len(data) - 9])
        case "bent":
            path.write_bytes(data[:-9] + bytes((data[-9] ^ 1,)) + data[-8:])
        case "emptied":
            path.write_bytes(b"")
        case _:
            path.mkdir()
    for start in range(2):
        vehicle = Vehicle(session)
        assert not has_all(vehicle)
        assert any(kind in text or "stored" in text for text in vehicle.greeted), vehicle.greeted
        assert vehicle.arm() == DENIED and "STATE_ACCEPT" in vehicle.reasons(), start
        assert not vehicle.tick().mode.armed
        vehicle.set_param("SPD_CRUISE", 0.29)  # accepts nothing
        vehicle.session.close()
    vehicle = Vehicle(session)
    vehicle.set_param("STATE_ACCEPT", 7, whole=True)
    assert vehicle.arm() == DENIED, "a number that nothing has accepts nothing"
    vehicle.set_param("STATE_ACCEPT", 1, whole=True)
    assert vehicle.arm() == ACCEPTED, vehicle.reasons()
    vehicle.session.close()
    vehicle = Vehicle(session)
    assert vehicle.session.parts.params["STATE_ACCEPT"] == 0
    assert vehicle.arm() == ACCEPTED, "it is known"


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.usefixtures("prepared")
def test_a_file_that_is_gone_is_missed_where_the_copy_before_is_left(
    session: OpenSession, tmp_path: Path, kind: str
) -> None:
    """A power cut on a card without a journal: an older fence, or older parameters, were in force without a word."""
    (tmp_path / "state" / "sitl-0" / FILES[kind]).unlink()
    for start in range(2):
        vehicle = Vehicle(session)
        assert any("the copy before is in force" in text for text in vehicle.greeted), vehicle.greeted
        assert vehicle.arm() == DENIED and "STATE_ACCEPT" in vehicle.reasons(), start
        vehicle.session.close()
    vehicle = Vehicle(session)
    vehicle.set_param("STATE_ACCEPT", 1, whole=True)
    assert vehicle.arm() == ACCEPTED, vehicle.reasons()
    vehicle.session.close()
    assert Vehicle(session).arm() == ACCEPTED, "it is known"


@pytest.mark.usefixtures("prepared")
def test_a_disk_that_fills_while_the_vehicle_runs_is_a_reason_from_the_next_save_on(
    session: OpenSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch, tmp_path / "state")
    vehicle = Vehicle(session)
    disk.break_with(errno.ENOSPC)
    vehicle.set_param("SPD_CRUISE", 0.28)
    assert vehicle.offer(vehicle.client, PlanKind.FENCE, paper_plan().fence) == 0
    vehicle.run(0.5)
    assert vehicle.arm() == DENIED and "disk full" in vehicle.reasons()
    disk.break_with(0)
    vehicle.run(12.0)
    assert vehicle.arm() == ACCEPTED, vehicle.reasons()


def test_a_line_that_is_not_taken_is_a_loss_and_stays_until_it_is_accepted(
    session: OpenSession, tmp_path: Path
) -> None:
    path = tmp_path / "state" / "sitl-0" / "parameters.params"
    path.parent.mkdir(parents=True)
    path.write_text("SPD_CRUISE 0.2\nDEPTH_MAX deep\n")
    for _ in range(2):
        vehicle = Vehicle(session)
        assert vehicle.arm() == DENIED and "1 stored parameter not loaded" in vehicle.reasons()
        vehicle.set_param("SPD_CRUISE", 0.21)
        vehicle.session.close()
    assert "DEPTH_MAX deep" in path.read_text()
    vehicle = Vehicle(session)
    vehicle.set_param("STATE_ACCEPT", 1, whole=True)
    assert vehicle.arm() == ACCEPTED, vehicle.reasons()
    vehicle.session.close()
    assert "deep" not in path.read_text()
    assert Vehicle(session).arm() == ACCEPTED
