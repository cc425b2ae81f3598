"""``autopilot calibrate flight --connect`` over the wire: what it flies, and that the old mission comes back."""

import io
from pathlib import Path

import numpy as np
import pytest
from client_world import MemoryLink

from autopilot.cli.calibrate_flight import flight
from autopilot.cli.main import run
from autopilot.client.client_session import CommandRefusedError, VehicleConnection
from autopilot.client.plan_client import same_on_the_wire
from autopilot.core.errors import DriverError
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.paper import paper_plan

FENCE = paper_plan().fence[:4]


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch) -> MemoryLink:
    """A vehicle with the paper's tank and mission."""
    world = MemoryLink()
    monkeypatch.setattr("autopilot.client.client_session.open_link", lambda text: world)
    client = VehicleConnection(world, clock_s=world.clock_s)
    client.connect()
    client.upload(PlanKind.FENCE, FENCE)
    client.upload(PlanKind.MISSION, paper_plan().mission)
    return world


@pytest.fixture
def flown(link: MemoryLink, monkeypatch: pytest.MonkeyPatch) -> list[tuple[PlanItem, ...]]:
    """Missions that were started; the vehicle surfaces and disarms with its last item."""
    missions: list[tuple[PlanItem, ...]] = []
    start, tick = link.vehicle.start_mission, link.vehicle.tick

    def started(first_seq: int | None) -> object:
        missions.append(link.plans.items(PlanKind.MISSION))
        return start(first_seq)

    def ticked(t_us: int) -> object:
        answer = tick(t_us)
        link.vehicle.armed &= not missions or len(missions[-1]) - 1 not in answer[0]
        return answer

    monkeypatch.setattr(link.vehicle, "start_mission", started)
    monkeypatch.setattr(link.vehicle, "tick", ticked)
    return missions


def call(tmp_path: Path, *arguments: str) -> int:
    given = ["--connect", "udpout:127.0.0.1:1", "--log", str(tmp_path), "--out", str(tmp_path / "new.toml")]
    return run(lambda: flight.main([*given, "--floor", "1.5", "--laps", "1", *arguments], standalone_mode=False))


def kept(link: MemoryLink) -> bool:
    return same_on_the_wire(link.plans.items(PlanKind.MISSION), paper_plan().mission)


def test_the_manoeuvre_is_flown_and_the_mission_is_put_back(
    link: MemoryLink,
    flown: list[tuple[PlanItem, ...]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("autopilot.cli.calibrate_flight.CLOSED_S", 0.0)
    assert call(tmp_path, "--yes") == 1
    assert "holds no log of this flight" in capsys.readouterr().err
    assert call(tmp_path, "--yes", "--log", str(tmp_path / "none")) == 1
    assert "none: is not there; name the file that the service logs to" in capsys.readouterr().err
    (mission,) = flown
    assert {item.command for item in mission} == {16, 21}
    assert len(mission) == 15
    assert kept(link)
    assert not link.vehicle.armed


def test_a_flight_that_is_stopped_puts_the_mission_back(
    link: MemoryLink,
    flown: list[tuple[PlanItem, ...]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("autopilot.client.client_session.VehicleConnection.watch_mission", stop)
    assert call(tmp_path, "--yes") == 130
    assert "stopped: the vehicle holds, armed" in capsys.readouterr().err
    assert len(flown) == 1
    assert kept(link)


def test_nothing_is_flown_without_a_yes_a_fence_or_room(
    link: MemoryLink, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for answer in ("n\n", ""):  # no, and nobody there to answer
        monkeypatch.setattr("sys.stdin", io.StringIO(answer))
        assert call(tmp_path) == 130
    link.vehicle.not_ready = "no position estimate"
    assert call(tmp_path, "--yes") == 1
    assert "no position estimate" in capsys.readouterr().err
    assert kept(link)
    client = VehicleConnection(link, clock_s=link.clock_s)
    client.connect()
    client.upload(PlanKind.MISSION, ())
    client.upload(PlanKind.FENCE, ())
    assert call(tmp_path, "--yes") == 1
    assert "the vehicle has no fence to stay inside" in capsys.readouterr().err
    assert link.vehicle.starts == 0
    link.vehicle.armed = True
    assert call(tmp_path, "--yes") == 1
    assert "the vehicle is armed" in capsys.readouterr().err


def test_parameters_and_messages_are_asked_for() -> None:
    link = MemoryLink()
    client = VehicleConnection(link, clock_s=link.clock_s)
    client.connect()
    assert client.parameter("DEPTH_MAX") == pytest.approx(1.2)
    place = client.message(32)
    assert (place.x, place.y) == pytest.approx(tuple(np.asarray(link.vehicle.pos[:2]).tolist()))
    with pytest.raises(CommandRefusedError):
        client.message(147)  # BATTERY_STATUS without a battery
    with pytest.raises(CommandRefusedError, match="NO_SUCH: the vehicle did not answer"):
        client.parameter("NO_SUCH")
    link.vehicle.armed = True
    client.poll(1.5)
    with pytest.raises(DriverError, match="still armed after 2 s"):
        client.wait_disarmed(2.0)
