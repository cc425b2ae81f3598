"""QGroundControl's order of messages against the service as a process: no popup, nothing in red, no silence."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from ground_station import GroundStation
from pymavlink.dialects.v20 import development as mav
from system_harness import RunningService

from autopilot.cli.console_output import EXIT_LOSS
from autopilot.client.plan_client import same_on_the_wire
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.core.plan_wire import item_of
from autopilot.mission.paper import paper_plan
from autopilot.run.children import Child, autopilot_command, free_port

SPEED = 2.0
LAT_DEG, LON_DEG = 37.9755, 23.7790


def rally() -> tuple[PlanItem, ...]:
    first = paper_plan().mission[0]
    return (PlanItem(seq=0, frame=3, command=mav.MAV_CMD_NAV_RALLY_POINT, x=first.x, y=first.y, z=-0.45),)


@contextmanager
def running(folder: Path, profile: str, port: int, *arguments: str) -> Iterator[RunningService]:
    command = autopilot_command(
        *("sitl", "paper-tank", "--quiet", "--sensors", "pose", "--speed", f"{SPEED:g}", "--profile", profile),
        *("--connect", f"udpin:127.0.0.1:{port}", "--keep-plans", *arguments),
    )
    places = {"AUTOPILOT_STATE_DIR": str(folder / "state"), "AUTOPILOT_LOG_DIR": str(folder / "logs")}
    child = Child(command, places)
    try:
        yield RunningService(child=child, port=port, log=folder)
    finally:
        assert child.end() in (0, EXIT_LOSS)  # disarmed, it drifts against a wall


@pytest.mark.parametrize("profile", ["px4", "ardusub", "generic"])
def test_an_evening_with_a_ground_station(profile: str, tmp_path: Path) -> None:
    port, plan = free_port(), paper_plan(1)
    with running(tmp_path, profile, port) as service:
        station = GroundStation(service, port, profile, SPEED)
        station.connect()
        station.rest(2.5)
        assert not station.flying
        # Plan view: all three types, as QGroundControl sends them, and what comes back is what was sent.
        plans = {PlanKind.MISSION: plan.mission, PlanKind.FENCE: plan.fence, PlanKind.RALLY: rally()}
        for kind, items in plans.items():
            assert station.upload(kind, items) == mav.MAV_MISSION_ACCEPTED
        for kind, items in plans.items():
            back = [item_of(message) for message in station.download(kind)]
            if profile == "ardusub" and kind is PlanKind.MISSION:
                back = [replace(item, seq=item.seq - 1, param1=_jump(item)) for item in back[1:]]
            assert same_on_the_wire(back, items), (kind, back, items)
        station.ready()
        fly(station, profile)
        edit(station)
        if profile == "px4":
            summary(station)
            files(station)
            absence(station)
        if profile == "generic":
            reboot(station)
    station.close()
    assert any("Underwater Autopilot" in text for _, text in station.texts), "never greeted"
    assert station.trouble == []


def _jump(item: PlanItem) -> float:
    """DO_JUMP's target is a number too."""
    return item.param1 - 1.0 if item.command == mav.MAV_CMD_DO_JUMP else item.param1


def fly(station: GroundStation, profile: str) -> None:
    """Start, pause, go-to, another depth, on with the mission, return, takeoff, land."""
    station.ready()
    station.start_mission()
    station.until(lambda: station.mode == "Mission", "the mission runs", 5.0)
    station.until(lambda: station.flying, "flying", 5.0)
    station.rest(2.0)
    station.pause()
    station.until(lambda: station.mode in ("Hold", "Guided"), "paused", 5.0)
    if profile != "generic":
        station.go_to(LAT_DEG, LON_DEG + 0.57e-5)
        station.rest(1.0)
        station.change_altitude(0.1)
        station.rest(1.0)
        station.set_mode("Mission")
        station.until(lambda: station.mode == "Mission", "on with the mission", 5.0)
        home, up = ("RTL", "Surface") if profile == "ardusub" else ("Return", "Land")
        station.set_mode(home)
        station.until(lambda: station.mode == home, "return", 5.0)
        station.been.clear()
        heard = len(station.texts)

        def dived() -> bool:
            return any("Dived to" in text for _, text in station.texts[heard:])

        station.command(22, -1.0, 0.0, 0.0, *(math.nan,) * 3, 2.0)
        # A vehicle that is deep enough already has dived at once.
        station.until(lambda: station.modes["Dive"] in station.been or dived(), "takeoff", 5.0)
        station.set_mode(up)
    else:
        station.command(193, 1.0)
        station.rest(1.0)
        station.command(20)
        station.rest(1.0)
        station.command(21)
    station.until(lambda: not station.armed, "surfaced and disarmed", 60.0)
    station.until(lambda: not station.flying, "on the ground", 5.0)


def edit(station: GroundStation) -> None:
    """The parameter editor: whole numbers, others, and what is refused with its reason."""
    assert station.edit("SPD_CRUISE", 0.3)
    assert station.edit("FS_SOLVER_N", 41)
    station.allowed.append("SPD_CRUISE")
    assert not station.edit("SPD_CRUISE", 50.0)
    station.until(lambda: any("SPD_CRUISE" in text for _, text in station.texts), "the reason of a refusal", 2.0)


def summary(station: GroundStation) -> None:
    """Rows of the summary and the power page, as the plug-in makes them of parameters."""
    shown = {name: station.value(name) for name in ("RTL_LAND_DELAY", "CAL_MAG0_ID", "BAT1_N_CELLS", "BAT1_V_CHARGED")}
    assert shown["RTL_LAND_DELAY"] < 0.0, "Return, then: loiter and do not land"
    assert shown["CAL_MAG0_ID"] != 0, "Compass 0: ready"
    assert shown["BAT1_N_CELLS"] * shown["BAT1_V_CHARGED"] == pytest.approx(19.0), "Battery Max"
    assert station.value("FRAME_CONFIG") == 5, "four thrusters"
    assert station.edit("FS_GCS_ENABLE", 3)
    assert station.value("NAV_DLL_ACT") == 1, "hold, as FS_GCS_ENABLE says"
    assert station.edit("FS_GCS_ENABLE", 1)


def files(station: GroundStation) -> None:
    """Both log pages give the same bytes."""
    logs = station.logs()
    assert logs, "an armed vehicle leaves a log"
    entry = logs[0]
    size = min(entry.size, 20_000)
    numbered = station.log_data(entry.id, size)
    days = station.folder("@MAV_LOG")
    assert days and all(day.startswith("D") for day in days)
    names = [name for name in station.folder(f"@MAV_LOG/{days[0][1:]}") if ".mcap" in name]
    filed = station.fetch(f"@MAV_LOG/{days[0][1:]}/{names[0][1:].split(chr(9))[0]}")
    assert numbered == filed[:size] and filed.startswith(b"\x89MCAP0\r\n")


def reboot(station: GroundStation) -> None:
    """The vehicle starts anew by command; the station does not, and shows the plan and the parameters that it knows."""
    before = [item_of(message) for message in station.download(PlanKind.MISSION)]
    clock_s = station.vehicle_s
    station.command(246, 1.0)
    station.last.clear()
    station.until(lambda: 0.0 < station.vehicle_s < clock_s, "begun anew", math.inf)
    station.heartbeat_s = None
    assert [item_of(message) for message in station.download(PlanKind.MISSION)] == before
    assert station.read("SPD_CRUISE").param_value == pytest.approx(0.3)


def absence(station: GroundStation) -> None:
    """The link goes, and comes back."""
    station.allowed.append("[Gg]round station")
    station.beating = False
    station.rest(7.0)
    station.beating = True
    station.rest(2.0)
    assert station.command(512, 148) == 0


def test_a_refused_plan_names_the_guilty_item_and_leaves_the_old_one(tmp_path: Path) -> None:
    """QGroundControl names the item that was asked for last; both the whole plan's check and an item's go that way."""
    port, plan = free_port(), paper_plan(1)
    with running(tmp_path, "px4", port) as service:
        station = GroundStation(service, port, "px4", SPEED)
        station.meet()
        assert station.upload(PlanKind.MISSION, plan.mission) == 0
        station.allowed.append(".")
        loop = PlanItem(seq=1, frame=2, command=mav.MAV_CMD_DO_JUMP, param1=1.0, param2=-1.0, param4=0.0)
        bad = (plan.mission[0], loop, *(replace(plan.mission[1], seq=n) for n in (2, 3)))
        above = (plan.mission[0], replace(plan.mission[1], z=50.0), *(replace(plan.mission[1], seq=n) for n in (2, 3)))
        for items in (bad, above):
            station.trouble.clear()
            assert station.upload(PlanKind.MISSION, items) not in (None, 0)
            assert len(station.trouble) == 1 and station.trouble[0].endswith("blamed on item 1"), station.trouble
            assert [item_of(m).seq for m in station.download(PlanKind.MISSION)] == [0, 1, 2, 3]
        station.close()
