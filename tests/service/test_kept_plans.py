"""What a vehicle keeps of its plans: read as it was written, or not at all and said so."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.command.service_parts import ServiceParts
from autopilot.core.background import BackgroundWorker
from autopilot.core.geodesy import Origin
from autopilot.core.latest_value_writer import KEEP_TICKS, RETRY_TICKS, LatestValueWriter
from autopilot.core.plan import PlanKind
from autopilot.core.state_file import StateFile
from autopilot.mission.paper import paper_plan
from autopilot.mission.sequencer import Position
from autopilot.mission.store import Plans
from autopilot.run.config import flight_settings
from autopilot.run.kept_plans import KeptPlans
from autopilot.run.sitl_session import open_sitl


def _parts(folder: Path) -> ServiceParts:
    values = flight_settings(folder / "state", {"sensors": "pose", "log_dir": str(folder / "logs")})
    return open_sitl(values, {}, log=False).parts


def _upload(plans: Plans) -> None:
    plan = paper_plan()
    for kind in (PlanKind.FENCE, PlanKind.MISSION, PlanKind.RALLY):
        assert plans.replace(kind, plan.items(kind)) is None


def _written(folder: Path) -> tuple[Path, ServiceParts]:
    """A file with the paper's plan, home and a position in the second lap."""
    path, parts = folder / "plans.json", _parts(folder)
    kept = KeptPlans(path, parts.plans, parts.commander)
    assert kept.load() == ()
    _upload(parts.plans)
    parts.plans.set_home(parts.plans.home_ned_m + np.array([1.25, -0.5, 0.0]))
    parts.commander.stand_at(
        Position(
            cursor=2,
            reached_seq=1,
            lap=1,
            jumps_done=((3, 1),),
            speed_m_s=0.2,
            default_yaw_rad=None,
            standing=(("photos by time", 1),),
        )
    )
    kept.tick(10_000)
    kept.tick((KEEP_TICKS + 1) * 10_000)
    assert kept.failure is None
    return path, parts


def _same(a: ServiceParts, b: ServiceParts) -> bool:
    kinds = all(a.plans.checksum(kind) == b.plans.checksum(kind) for kind in PlanKind)
    items = all(repr(a.plans.items(kind)) == repr(b.plans.items(kind)) for kind in PlanKind)
    home = (a.plans.home_ned_m == b.plans.home_ned_m).all()
    return kinds and items and bool(home) and a.plans.origin == b.plans.origin


def test_everything_comes_back(tmp_path: Path) -> None:
    path, before = _written(tmp_path)
    after = _parts(tmp_path)
    assert KeptPlans(path, after.plans, after.commander).load() == ()
    assert _same(before, after)
    assert after.commander.mission_position == before.commander.mission_position
    assert not after.commander.armed
    assert [p.name for p in tmp_path.glob("plans.json*")] == ["plans.json"]


def test_a_place_to_face_does_not_move_with_the_origin(tmp_path: Path) -> None:
    path, before = _written(tmp_path)
    position = before.commander.mission_position
    assert position is not None
    before.commander.stand_at(replace(position, facing_ned_m=(3.0, 1.0)))
    kept = KeptPlans(path, before.plans, before.commander)
    before.plans.set_home(before.plans.home_ned_m + 0.0)
    kept.tick(10_000)
    kept.finish()
    for moved_deg, facing in ((0.0, (3.0, 1.0)), (1e-5, None)):
        after = _parts(tmp_path)
        origin = after.plans.origin
        assert after.plans.set_origin(replace(origin, lat_deg=origin.lat_deg + moved_deg)) is None
        KeptPlans(path, after.plans, after.commander).load()
        assert after.commander.mission_position is not None
        assert after.commander.mission_position.facing_ned_m == facing


def test_progress_in_the_plan_before_is_not_kept_with_a_new_one(tmp_path: Path) -> None:
    """The commander takes a new plan with its next decision; the power may fail before."""
    path, parts = _written(tmp_path)
    kept = KeptPlans(path, parts.plans, parts.commander)
    assert parts.plans.replace(PlanKind.MISSION, paper_plan().mission[:1]) is None
    kept.tick(10_000)
    kept.finish()
    after = _parts(tmp_path)
    assert KeptPlans(path, after.plans, after.commander).load() == ()
    assert _same(parts, after)
    assert after.plans.items(PlanKind.FENCE)


def test_any_damage_is_found_and_the_copy_before_is_used(tmp_path: Path) -> None:
    path, before = _written(tmp_path)
    kept = KeptPlans(path, before.plans, before.commander)
    before.plans.set_home(before.plans.home_ned_m + np.array([0.0, 0.0, 0.0]))
    kept.tick(10_000)
    kept.finish()
    whole = path.read_bytes()
    previous = StateFile(path).previous.read_bytes()
    parts = _parts(tmp_path)
    spoilt = [whole[:n] for n in range(0, len(whole), 97)]
    spoilt += [whole[:n] + bytes([whole[n] ^ 1]) + whole[n + 1 :] for n in range(0, len(whole) - 1, 83)]
    for data in spoilt:
        path.write_bytes(data)
        (warning,) = KeptPlans(path, parts.plans, parts.commander).load()
        assert str(path) in warning
        assert _same(before, parts)
        assert not path.exists() and StateFile(path).previous.read_bytes() == previous


def test_without_a_whole_copy_there_is_no_plan_and_that_is_said(tmp_path: Path) -> None:
    path, _ = _written(tmp_path)
    for data in (b"", b"{}", path.read_bytes().replace(b'"version":1', b'"version":2')):
        path.write_bytes(data)
        parts = _parts(tmp_path)
        warnings = KeptPlans(path, parts.plans, parts.commander).load()
        assert "no plan on board" in warnings[-1]
        assert not any(parts.plans.items(kind) for kind in PlanKind)
        assert StateFile(path).damaged.read_bytes() == data


def test_plans_that_are_refused_today_are_set_aside_and_nothing_of_them_is_in_force(tmp_path: Path) -> None:
    """The origin was moved before they were kept: it is not in force without them either."""
    parts = _parts(tmp_path)
    path, configured = tmp_path / "plans.json", parts.plans.origin
    kept = KeptPlans(path, parts.plans, parts.commander)
    moved = Origin(lat_deg=configured.lat_deg + 1e-5, lon_deg=configured.lon_deg, alt_m=configured.alt_m)
    assert parts.plans.set_origin(moved) is None
    _upload(parts.plans)
    kept.tick(10_000)
    kept.finish()
    whole = path.read_bytes()
    after = _parts(tmp_path)
    after.params.set("DEPTH_MAX", 0.2)
    kept = KeptPlans(path, after.plans, after.commander)
    (warning,) = kept.load()
    assert "plans.json.damaged" in warning and "upload them again" in warning
    assert not any(after.plans.items(kind) for kind in PlanKind)
    assert after.plans.origin == configured
    kept.tick(10_000)
    kept.tick((KEEP_TICKS + 1) * 10_000)
    assert StateFile(path).damaged.read_bytes() == whole
    third = _parts(tmp_path)
    assert KeptPlans(path, third.plans, third.commander).load() == ()
    assert not any(third.plans.items(kind) for kind in PlanKind)


def test_the_mission_goes_home_to_where_home_was_before_the_restart(tmp_path: Path) -> None:
    path, before = _written(tmp_path)
    after = _parts(tmp_path)
    KeptPlans(path, after.plans, after.commander).load()
    assert (after.commander._mission.sequencer._goals.home_ned_m == before.plans.home_ned_m).all()


def test_a_disk_that_fails_once_is_tried_again_without_a_change(tmp_path: Path) -> None:
    folder, parts = tmp_path / "gone", _parts(tmp_path)
    folder.write_bytes(b"in the way")
    kept = KeptPlans(folder / "plans.json", parts.plans, parts.commander)
    kept.load()
    _upload(parts.plans)
    for tick in range(RETRY_TICKS):
        kept.tick(tick * 10_000)
    assert kept.failure is not None
    folder.unlink()
    for tick in range(RETRY_TICKS, 2 * RETRY_TICKS):
        kept.tick(tick * 10_000)
    assert kept.failure is None
    again = _parts(tmp_path)
    assert KeptPlans(folder / "plans.json", again.plans, again.commander).load() == ()
    assert _same(parts, again)


def test_a_disk_that_fails_is_told_once_and_tried_with_the_next_change(tmp_path: Path) -> None:
    folder, parts = tmp_path / "gone", _parts(tmp_path)
    folder.write_bytes(b"in the way")
    kept = KeptPlans(folder / "plans.json", parts.plans, parts.commander)
    assert "cannot be read" in kept.load()[0]
    for k in range(4):
        parts.plans.set_home(parts.plans.home_ned_m + np.array([1.0, 0.0, 0.0]))
        for tick in range(10 * k, 10 * k + 10):
            kept.tick(tick * 10_000)
    assert [text for _, text in kept.take_notices()] == ["Plans not saved: folder gone"]
    folder.unlink()
    parts.plans.set_home(parts.plans.home_ned_m + np.array([1.0, 0.0, 0.0]))
    kept.tick(1_000_000)
    kept.finish()
    assert (folder / "plans.json").exists()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_the_newest_state_is_always_the_one_that_is_written(steps: list[tuple[bool, bool]]) -> None:
    """Whatever comes while the disk is busy, and whichever writes fail."""
    written: list[int] = []
    failing = False
    settled = 0

    def write(state: int) -> None:
        if failing:
            raise OSError(28, "full")
        written.append(state)

    watchdog: LatestValueWriter[int] = LatestValueWriter(BackgroundWorker(), write)
    states = itertools.count(1)
    newest = 0
    for tick, (put, fails) in enumerate(steps):
        failing = fails
        if put:
            newest = next(states)
            assert watchdog.put(tick, newest) == newest
        kept = watchdog.poll(tick)
        if kept is not None:
            assert kept.number > settled
            settled = kept.number
            assert kept.error is not None or written[-1] == settled
    failing = False
    assert watchdog.finish() is None
    assert (written[-1] if written else 0) == newest
    assert written == sorted(written)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 0.1 + 0.2, -0.0])
def test_numbers_come_back_bit_for_bit(value: float) -> None:
    from autopilot.core.plan import PlanItem
    from autopilot.run.plans_format import plan_item, stored_item

    item = PlanItem(seq=0, frame=3, command=16, param1=value, param4=value, z=value)
    assert repr(plan_item(stored_item(item))) == repr(item)


def test_what_is_not_on_disk_at_the_end_is_a_failure(tmp_path: Path) -> None:
    """Of a run that ends in order: the exit code goes by it."""
    for spoilt in (False, True):
        folder = tmp_path / str(spoilt)
        folder.mkdir()
        path, parts = folder / "state" / "kept.json", _parts(folder)
        kept = KeptPlans(path, parts.plans, parts.commander)
        assert kept.load() == ()
        _upload(parts.plans)
        if spoilt:
            (folder / "state").rename(folder / "gone") if (folder / "state").exists() else None
            (folder / "state").write_text("no folder")
        kept.tick(10_000)
        kept.finish()
        assert (kept.failure is not None) is spoilt
        assert not spoilt or "plans are not saved" in str(kept.failure)
