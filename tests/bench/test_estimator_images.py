"""The picture benchmark: one real cell, the bars, the command and its figure."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from autopilot.cli.bench import bench as bench_command
from tests.bench import estimator_images
from tests.bench.estimator_images import ImageBench, ImageRow, missed

GOOD = ImageRow(
    turbidity_1_m=1.0,
    height_m=0.8,
    markers=18.0,
    xy_mm=0.8,
    z_mm=0.1,
    yaw_deg=0.005,
    lost_pct=0.0,
    empty_pct=0.0,
    false_ids=0,
    false_fixes=0,
    nees=4.0,
    laser_mm=2.0,
    laser_pct=100.0,
    laser_bad_pct=0.0,
    found_pct=100.0,
    cpu_ms=7.0,
    search_ms=50.0,
    missed="",
)


@pytest.fixture(scope="module")
def pictures() -> ImageBench:
    return ImageBench()


@pytest.mark.parametrize(("turbidity", "height"), [(0.3, 0.8), (3.0, 1.0)])
def test_cell_of_rendered_pictures(pictures: ImageBench, turbidity: float, height: float) -> None:
    row = pictures.cell(turbidity, height, 5)
    assert row.lost_pct == 0.0
    assert row.false_ids == row.false_fixes == 0
    assert row.found_pct == 100.0
    assert 0.1 < row.xy_mm < (2.0 if turbidity < 1.0 else 12.0)
    assert row.z_mm < row.xy_mm
    assert 0.5 < row.nees < 14.0
    assert row.cpu_ms > 0.0


def test_places_without_a_marker_are_not_lost_frames(pictures: ImageBench) -> None:
    row = pictures.cell(0.3, 0.2, 12)
    assert row.empty_pct > 50.0
    assert row.lost_pct == 0.0


def test_each_bar_can_be_missed() -> None:
    assert missed(GOOD) == []
    changes: dict[str, dict[str, Any]] = {
        "xy": {"xy_mm": 2.1},
        "z": {"z_mm": math.nan},
        "yaw": {"yaw_deg": 0.06},
        "lost": {"lost_pct": 2.5},
        "false fixes": {"false_fixes": 1},
        "laser": {"laser_mm": 11.0},
        "time": {"cpu_ms": 8.5},
    }
    for name, change in changes.items():
        assert missed(replace(GOOD, **change)) == [name]
    turbid = replace(GOOD, turbidity_1_m=2.0, xy_mm=4.9, yaw_deg=0.2, laser_mm=math.nan)
    assert missed(turbid) == []
    assert missed(replace(turbid, xy_mm=5.1)) == ["xy"]
    assert missed(replace(turbid, turbidity_1_m=3.0, xy_mm=50.0, lost_pct=50.0)) == []
    assert missed(replace(GOOD, height_m=1.3, cpu_ms=20.0, xy_mm=9.0)) == []


def test_command_prints_and_draws(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    rows = [replace(GOOD, turbidity_1_m=c, height_m=h) for c in (0.0, 1.0) for h in (0.3, 0.8)]
    monkeypatch.delenv("COLUMNS", raising=False)  # which pytest-xdist sets
    monkeypatch.setattr(estimator_images, "bench_images", lambda short: iter(rows))
    monkeypatch.setattr("autopilot.bench.machine.slowness", lambda: 1.0)
    done = CliRunner().invoke(bench_command, ["estimator", "--images", "--figures", str(tmp_path / "new")])
    assert done.exit_code == 0, done.output
    assert "yaw" in done.output
    as_json = CliRunner().invoke(bench_command, ["estimator", "--images", "--json"])
    assert [row["height_m"] for row in json.loads(as_json.output)["estimator"]["rows"]] == [0.3, 0.8, 0.3, 0.8]
    assert (tmp_path / "new" / "estimator-images.png").stat().st_size > 20_000
    for wrong in (["sitl", "--images"], ["estimator", "--figures", "x"], ["estimator", "--recompute"]):
        assert CliRunner().invoke(bench_command, wrong).exit_code == 2
