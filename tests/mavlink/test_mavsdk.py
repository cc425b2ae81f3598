"""A client that we did not write: MAVSDK against the server on a UDP socket, in real time."""

import json
import math
import queue
import random
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mavlink_harness import World
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.component_metadata import ComponentMetadata, MetadataType
from mavsdk.plugins.events import Events
from mavsdk.plugins.ftp import Ftp, FtpError
from mavsdk.plugins.log_files import LogFiles
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw, MissionRawError
from mavsdk.plugins.param import Param, ParamError
from mavsdk.plugins.telemetry import Telemetry
from mavsdk_link import found

from autopilot.core.arming_reasons import ArmingReason, HealthComponent, ModeGroup
from autopilot.core.background import BackgroundWorker
from autopilot.core.geodesy import GeodeticPosition
from autopilot.core.messages import MavlinkFrame, MissionProgress, ProgressState
from autopilot.core.plan import PlanKind
from autopilot.log.directory_reader import LogDirectoryReader
from autopilot.mavlink.api import CommandReply, CommandResult, FlightMode
from autopilot.mavlink.stubs import stubs_of

NAN = math.nan


@pytest.fixture(name="link", params=["px4", "generic"])
def link_fixture(request: pytest.FixtureRequest) -> Iterator[tuple[World, Any]]:
    with vehicle(request.param) as both:
        yield both


@contextmanager
def vehicle(profile: str, log_directory: LogDirectoryReader | None = None) -> Iterator[tuple[World, Any]]:
    """One vehicle as MAVSDK finds it."""
    world = World(profile, log_directory=log_directory)
    world.show(armed=False, mode=FlightMode.HOLD, intended_mode=FlightMode.HOLD)
    start_s = time.monotonic()

    def step(received: Sequence[bytes]) -> list[bytes]:
        t_us = int((time.monotonic() - start_s) * 1e6)
        frames = [MavlinkFrame(link=0, data=data) for data in received]
        return [frame.data for frame in world.server.step(t_us, frames, world.view)]

    with found(step) as (system, _):
        yield world, system


def progress_at(seq: int) -> MissionProgress:
    return MissionProgress(t_us=0, current_seq=seq, reached_seq=-1, lap=0, state=ProgressState.ACTIVE)


def items(count: int, kind: int = 0) -> list[Any]:
    command = {0: 16, 1: 5004, 2: 5100}[kind]
    return [
        MissionItem(n, 3, command, int(n == 0), 1, 0.5, 0.3, 0.0, NAN, 379_755_000 + n, 237_790_000 - n, -0.45, kind)
        for n in range(count)
    ]


def content(plan: list[Any]) -> list[tuple[Any, ...]]:
    """Items as comparable numbers; NaN as None."""
    names = ("seq", "frame", "command", "autocontinue", "param1", "param2", "param3", "param4", "x", "y", "z")
    rows = []
    for item in plan:
        values = [getattr(item, name) for name in names] + [item.mission_type]
        rows.append(tuple(None if v != v else float(np.float32(v)) if isinstance(v, float) else v for v in values))
    return rows


def test_mavsdk_gets_along(link: tuple[World, Any]) -> None:
    world, system = link
    raw, action, param = MissionRaw(system), Action(system), Param(system)

    mission, fence, rally = items(25), items(4, 1), items(2, 2)
    raw.upload_mission(mission)
    raw.upload_geofence(fence)
    raw.upload_rally_points(rally)
    assert [len(world.plans.items(kind)) for kind in PlanKind] == [25, 4, 2]
    assert content(raw.download_mission()) == content(mission)
    assert content(raw.download_geofence()) == content(fence)
    assert content(raw.download_rallypoints()) == content(rally)

    bad = items(5)
    bad[3].command = 9999
    with pytest.raises(MissionRawError, match="UNSUPPORTED"):
        raw.upload_mission(bad)
    assert len(world.plans.items(PlanKind.MISSION)) == 25

    action.arm()
    raw.start_mission()
    raw.pause_mission()
    action.return_to_launch()
    action.land()
    action.set_current_speed(0.2)
    action.kill()
    world.vehicle.on_set_current = lambda seq: world.show(progress=progress_at(seq))
    raw.set_current_mission_item(3)
    calls = [call for call in world.vehicle.calls if call[0] != "change_speed"]
    # A choice of item has no acknowledgement: MAVSDK sends it again when this machine is slow.
    assert [call for n, call in enumerate(calls) if n == 0 or call != calls[n - 1]] == [
        ("arm", False),
        ("set_mode", FlightMode.MISSION),
        ("set_mode", FlightMode.HOLD),
        ("set_mode", FlightMode.RETURN),
        ("set_mode", FlightMode.SURFACE),
        ("disarm", True),
        ("set_current_item", 3),
    ]
    world.vehicle.answers["arm"] = CommandReply(result=CommandResult.DENIED, reason="Arming denied: no position")
    with pytest.raises(ActionError, match="DENIED"):
        action.arm()

    world.vehicle.calls.clear()
    action.goto_location(37.9756, 23.7791, 11.5, 90.0)
    (point, yaw_rad) = next(call[1:] for call in world.vehicle.calls if call[0] == "go_to" and call[1] is not None)
    assert (point.lat_deg, point.lon_deg, point.alt_m) == pytest.approx((37.9756, 23.7791, 11.5), abs=2e-7)
    assert yaw_rad == pytest.approx(math.pi / 2)

    world.show(origin=GeodeticPosition(lat_deg=38.0, lon_deg=24.0, alt_m=3.0))
    action.set_gps_global_origin(38.0, 24.0, 3.0)

    assert param.get_param_float("SPD_CRUISE") == pytest.approx(0.35)
    assert param.get_param_int("FS_SOLVER_N") == 40
    param.set_param_float("SPD_CRUISE", 0.3)
    param.set_param_int("FS_SOLVER_N", 41)
    assert (world.params["SPD_CRUISE"], world.params["FS_SOLVER_N"]) == (0.3, 41.0)
    with pytest.raises(ParamError):
        param.set_param_float("SPD_CRUISE", 50.0)
    every = param.get_all_params()
    names = {value.name for value in (*every.int_params, *every.float_params)}
    assert names == set(world.params) | set(stubs_of(world.server._ctx.profile))

    raw.clear_mission()
    assert world.plans.items(PlanKind.MISSION) == ()


def test_the_usual_wait_for_a_vehicle_that_is_ready_ends(link: tuple[World, Any]) -> None:
    """MAVSDK's examples wait for ``health_all_ok`` before they arm."""
    world, system = link
    telemetry = Telemetry(system)
    ready, told = threading.Event(), threading.Event()
    telemetry.subscribe_health_all_ok(lambda ok, _: ready.set() if ok else None)
    telemetry.subscribe_raw_gps(lambda gps, _: told.set())
    assert ready.wait(120.0) and told.wait(120.0)
    health = telemetry.health()
    assert health.is_global_position_ok and health.is_local_position_ok and health.is_armable
    lost = threading.Event()
    telemetry.subscribe_health(lambda health, _: None if health.is_global_position_ok else lost.set())
    world.show(nav=None)
    assert lost.wait(120.0)


def test_why_arming_is_denied_is_a_report(link: tuple[World, Any]) -> None:
    world, system = link
    modes = ModeGroup.POSITION | ModeGroup.MISSION
    blind = ArmingReason("no position yet: markers must be in view", HealthComponent.POSITION, modes)
    long = "plan: xqzj kwvy 0.12 m inside of the fence, between 12.345 and 67.891"
    world.show(arming_reasons=(blind, ArmingReason(long, HealthComponent.MISSION)))
    reports: queue.Queue[Any] = queue.Queue()
    events = Events(system)
    events.subscribe_health_and_arming_checks(lambda report, _: reports.put(report))
    report = reports.get(timeout=240.0)
    mode = report.current_mode_intention
    assert (mode.mode_name, mode.can_arm_or_run) == ("Hold", False)
    problem, *parts = mode.problems
    assert (problem.message, problem.health_component) == (blind.text, "position")
    assert " ".join(part.message.removeprefix("... ") for part in parts) == long and len(parts) > 1
    assert {part.name for part in report.health_components if part.has_error} == {"position", "mission"}
    world.show(arming_reasons=())
    while not reports.get(timeout=240.0).current_mode_intention.can_arm_or_run:
        pass
    assert not events.get_health_and_arming_checks_report().all_problems


def test_logs_and_metadata_come_whole(tmp_path: Path) -> None:
    folder = tmp_path / "logs" / "2026-11-22"
    folder.mkdir(parents=True)
    content = random.Random(5).randbytes(100_000)
    (folder / "10_00_00.mcap").write_bytes(content)
    with vehicle("px4", LogDirectoryReader(folder.parent, BackgroundWorker())) as (world, system):
        ftp = Ftp(system)
        assert [entry.name for entry in ftp.list_directory("@MAV_LOG").entries] == ["2026-11-22"]
        for burst in (True, False):
            target = tmp_path / f"burst{burst}"
            target.mkdir()
            done = threading.Event()

            def told(result: Any, progress: Any, _: Any, done: threading.Event = done) -> None:
                if result.name != "NEXT":
                    done.set()

            ftp.download_async("@MAV_LOG/2026-11-22/10_00_00.mcap", str(target), burst, told)
            assert done.wait(240.0)
            assert (target / "10_00_00.mcap").read_bytes() == content
        assert ftp.are_files_identical(str(folder / "10_00_00.mcap"), "@MAV_LOG/2026-11-22/10_00_00.mcap")
        with pytest.raises(FtpError, match="PROTECTED"):
            ftp.remove_file("@MAV_LOG/2026-11-22/10_00_00.mcap")
        files = LogFiles(system)
        (entry,) = files.get_entries()
        fetched, ended = tmp_path / "fetched.mcap", threading.Event()
        files.download_log_file_async(entry, str(fetched), lambda r, p, _: None if r.name == "NEXT" else ended.set())
        assert ended.wait(240.0) and fetched.read_bytes() == content
        metadata = ComponentMetadata(system)
        there = threading.Event()
        metadata.subscribe_metadata_available(lambda update, _: there.set())
        metadata.request_autopilot_component()
        assert there.wait(240.0)
        found = json.loads(metadata.get_metadata(1, MetadataType.PARAMETER).json_metadata)
        names = {entry["name"] for entry in found["parameters"]}
        assert names >= set(world.params)
