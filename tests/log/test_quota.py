"""Old flights make room for new ones, and nothing else does."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.log.lock import lock_exclusive
from autopilot.log.log_session import log_path
from autopilot.log.quota import flights, remove_old_logs


def fly(folder: Path, day: str, time: str, size: int) -> Path:
    log = folder / day / f"{time}.mcap"
    log.parent.mkdir(parents=True, exist_ok=True)
    log.write_bytes(bytes(size))
    log.with_suffix(".tlog").write_bytes(bytes(size // 4))
    return log


def test_the_oldest_go_first_with_what_stands_beside_them(tmp_path: Path) -> None:
    old = fly(tmp_path, "2026-01-31", "23_59_59", 1000)
    second = fly(tmp_path, "2026-02-01", "00_00_01", 1000)
    third = fly(tmp_path, "2026-02-01", "00_00_01_2", 1000)
    last = fly(tmp_path, "2026-02-01", "00_00_01_10", 1000)
    foreign = tmp_path / "2026-01-01" / "my-best-flight.mcap"
    foreign.parent.mkdir()
    foreign.write_bytes(bytes(5000))
    assert [flight.log for flight in flights(tmp_path)] == [old, second, third, last]
    assert remove_old_logs(tmp_path, 2600, keep_free_bytes=0) == [old, second]
    assert not old.parent.exists(), "a day without flights goes as well"
    assert not second.with_suffix(".tlog").exists()
    assert third.exists() and last.exists() and foreign.exists()


def test_a_log_that_is_being_written_stays(tmp_path: Path) -> None:
    busy = fly(tmp_path, "2026-02-01", "10_00_00", 1000)
    idle = fly(tmp_path, "2026-02-01", "11_00_00", 1000)
    with busy.open("r+b") as file:
        assert lock_exclusive(file)
        assert remove_old_logs(tmp_path, 0, keep_free_bytes=0) == [idle]
    assert busy.exists()


def test_a_full_disk_counts_though_the_quota_is_kept(tmp_path: Path) -> None:
    log = fly(tmp_path, "2026-02-01", "10_00_00", 10)
    assert remove_old_logs(tmp_path, 10**9, keep_free_bytes=2**62) == [log]


def test_a_folder_that_is_not_there_needs_no_room(tmp_path: Path) -> None:
    assert remove_old_logs(tmp_path / "none", 0) == []


@pytest.mark.parametrize("boot_ns", [0, 1_790_000_000_000_000_000])
def test_flights_after_the_clock_was_set_back_are_not_the_oldest(tmp_path: Path, boot_ns: int) -> None:
    """A board without a clock of its own begins every time at 1970, or at the time that it saved last."""
    flown = [fly(tmp_path, "2026-11-28", f"10_00_0{n}", 1000) for n in range(3)]
    for _ in range(12):
        remove_old_logs(tmp_path, 3 * 1250, keep_free_bytes=0)
        path = log_path(tmp_path, boot_ns, last=True)
        flown.append(fly(tmp_path, path.parent.name, path.stem, 1000))
        assert [flight.log for flight in flights(tmp_path)] == flown[-4:]
    later = log_path(tmp_path, 1_900_000_000_000_000_000, last=True)
    assert later == tmp_path / "2030-03-17" / "17_46_40.mcap"


@given(sizes=st.lists(st.integers(0, 400), max_size=8), quota=st.integers(0, 1500))
def test_what_is_left_is_the_newest_that_fit(tmp_path_factory, sizes, quota) -> None:  # type: ignore[no-untyped-def]
    folder = tmp_path_factory.mktemp("logs")
    logs = [fly(folder, "2026-02-01", f"10_00_{n:02}", size) for n, size in enumerate(sizes)]
    remove_old_logs(folder, quota, keep_free_bytes=0)
    whole = [size + size // 4 for size in sizes]
    first_kept = next(n for n in range(len(sizes) + 1) if sum(whole[n:]) <= quota)
    assert [log.exists() for log in logs] == [n >= first_kept for n in range(len(logs))]
