"""Results of commands are written as a whole, into what is there, or not at all."""

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from autopilot.calibrate.vehicle_edit import write_updated
from autopilot.campaign.results import RunResult
from autopilot.campaign.run_table import write_tables
from autopilot.core.disk import in_place_of
from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.param_file import write_param_file
from autopilot.core.params import ParamSet
from autopilot.log.figures import save
from autopilot.mission.plan_files import write_plan
from autopilot.mission.plan_model import PlanFile
from autopilot.run.sitl_copy import write_copies

WRITERS: dict[str, Callable[[Path], object]] = {
    "own.params": lambda path: write_param_file(path, ParamSet()),
    "own.toml": lambda path: write_updated("lbv150", {"camera.latency_s": 0.05}, "test", path),
    "own.plan": lambda path: write_plan(path, PlanFile()),
}


@contextmanager
def full_disk(at_bytes: int = 16) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (at_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


PARTS: dict[str, Callable[[Path], object]] = {
    "runs.csv": lambda path: write_tables([RunResult(run=0, seed=1, drawn={})], path.parent),
    "own.png": lambda path: save(Figure(), path),
}
"""Of commands that name the folder."""


@pytest.mark.parametrize("name", PARTS)
def test_a_full_disk_leaves_a_table_or_figure_as_it_was(tmp_path: Path, name: str) -> None:
    target = tmp_path / name
    target.write_text("the old one")
    with full_disk(), pytest.raises(OSError, match="too large"):
        PARTS[name](target)
    assert target.read_text() == "the old one"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_ctrl_c_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    target = tmp_path / "own.csv"
    target.write_text("the old one")
    with pytest.raises(KeyboardInterrupt), in_place_of(target) as part:
        part.write_text("half of the new")
        raise KeyboardInterrupt
    assert target.read_text() == "the old one"
    assert [path.name for path in tmp_path.iterdir()] == ["own.csv"]


def test_copies_come_all_or_none(tmp_path: Path) -> None:
    """Else the next try finds one of them there and refuses."""
    copies = {tmp_path / "small": b"1", tmp_path / "large": b"1" * 99}
    with full_disk(), pytest.raises(ConfigError, match="choose another --out"):
        write_copies(copies, tmp_path)
    assert list(tmp_path.iterdir()) == []
    write_copies(copies, tmp_path)
    assert all(path.read_bytes() == data for path, data in copies.items())


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path, name: str) -> None:
    target = tmp_path / name
    target.write_text("the old one")
    with full_disk(), pytest.raises((ConfigError, PlanError), match=f"{name}: cannot be written"):
        WRITERS[name](target)
    assert target.read_text() == "the old one"
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", WRITERS)
def test_links_stay_links(tmp_path: Path, name: str) -> None:
    kept = tmp_path / "kept"
    kept.write_text("the old one")
    link = tmp_path / name
    link.symlink_to(kept)
    WRITERS[name](link)
    assert link.is_symlink() and len(kept.read_text()) > 20


def test_a_device_takes_the_content_and_stays(tmp_path: Path) -> None:
    link = tmp_path / "null"
    link.symlink_to("/dev/null")
    write_param_file(link, ParamSet())
    assert Path("/dev/null").is_char_device() and link.is_symlink()
