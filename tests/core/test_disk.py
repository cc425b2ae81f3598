"""Results of commands are written as a whole, into what is there, or not at all."""

import resource
from collections.abc import Callable
from pathlib import Path

import pytest

from autopilot.calibrate.vehicle_edit import write_updated
from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.param_file import write_param_file
from autopilot.core.params import ParamSet
from autopilot.mission.plan_files import write_plan
from autopilot.mission.plan_model import PlanFile

WRITERS: dict[str, Callable[[Path], object]] = {
    "own.params": lambda path: write_param_file(path, ParamSet()),
    "own.toml": lambda path: write_updated("lbv150", {"camera.latency_s": 0.05}, "test", path),
    "own.plan": lambda path: write_plan(path, PlanFile()),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path, name: str) -> None:
    target = tmp_path / name
    target.write_text("the old one")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, hard))
    try:
        with pytest.raises((ConfigError, PlanError), match=f"{name}: cannot be written"):
            WRITERS[name](target)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
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
