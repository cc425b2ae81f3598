"""``autopilot log compare``: what a newcomer reads off it, groups of seeds, and logs that have little in common."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from log_synthetic import DESCRIPTION, EPOCH_NS, Run, Truth, call, write_run

from autopilot.log.writer import LogWriter

Fly = Callable[..., Path]


@pytest.fixture(scope="module")
def fly(tmp_path_factory: pytest.TempPathFactory) -> Fly:
    """Writes a run of one lap: its power, and what is changed of its description."""
    folder = tmp_path_factory.mktemp("compare")

    def written(
        name: str, *, power_w: float = 20.0, seed: int = 1, truth: bool = True, config: str = "{}", **changes: Any
    ) -> Path:
        def change(_: float, truth: Truth) -> Truth:
            return replace(truth, power_w=power_w)

        accept = replace(DESCRIPTION.accept, laps=1)
        description = replace(DESCRIPTION, accept=accept, seed=seed, **changes)
        path = folder / f"{name}.mcap"
        run = Run(laps=1, step_us=200_000, description=description, change_truth=change, with_truth=truth)
        return write_run(path, replace(run, full_inputs=not truth, attachments={"config.json": config.encode()}))

    return written


@pytest.fixture(scope="module")
def two(fly: Fly) -> tuple[Path, Path]:
    costs = [{**DESCRIPTION.parameters, "MPC_COST": cost} for cost in (1.0, 0.0)]
    return fly("energy", power_w=8.0, parameters=costs[0]), fly("quadratic", power_w=28.0, parameters=costs[1])


LAP_S = 33.8
"""Of the synthetic run."""


def lap_j(power_w: float) -> float:
    return (power_w + DESCRIPTION.hotel_power_w) * LAP_S


def test_what_the_energy_is_worth_is_the_first_line(two: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out = call("compare", *two)
    first = out.splitlines()[0]
    assert code == 0 and "J a lap (2.00 times)" in first and "s a lap (1.00 times)" in first
    values = [float(word) for word in first.replace("J", "").split()[:3:2]]
    assert values == pytest.approx([lap_j(8.0), lap_j(28.0)], rel=0.03)
    assert "B has MPC_COST 0 (distance and effort at cruise speed), not 1 (energy)" in out
    assert "not comparable" not in out and max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize("order", [1, -1])
def test_ratios_are_to_the_first(two: tuple[Path, Path], order: int) -> None:
    code, out = call("compare", *two[::order], "--json")
    found = json.loads(out)
    energy = next(row for row in found["figures"] if row["name"] == "energy of a lap, median")
    assert code == 0 and energy["ratios"]["B"] == pytest.approx(2.0**order, rel=0.01)
    assert energy["values"]["A"]["spread"] is None
    assert [Path(column[0]["log"]) for column in found["columns"].values()] == list(two[::order])


def test_flights_that_differ_in_their_seed_only_are_one_column(fly: Fly, two: tuple[Path, Path]) -> None:
    other = fly("other", power_w=10.0, seed=2, parameters={**DESCRIPTION.parameters, "MPC_COST": 1.0})
    for logs in ((two[0], other, two[1]), (two[0], two[1], other)):
        found = json.loads(call("compare", *logs, "--json")[1])
        assert [len(column) for column in found["columns"].values()] == [2, 1]
        energy = next(row for row in found["figures"] if row["name"] == "energy of a lap, median")["values"]["A"]
        assert energy["count"] == 2
        assert energy["mean"] == pytest.approx(lap_j(9.0), rel=0.03)
        assert energy["spread"] == pytest.approx((lap_j(10.0) - lap_j(8.0)) / 2**0.5, rel=0.03)
    assert " ± " in call("compare", two[0], other, two[1])[1]
    alone = json.loads(call("compare", two[0], other, "--json")[1])
    assert set(alone["columns"]) == {"A", "B"} and "mean" in alone["figures"][0]["values"]
    again = json.loads(call("compare", two[0], two[0], "--json")[1])
    assert set(again["columns"]) == {"A", "B"}, "flights of one seed are no sample"


def test_flights_by_camera_and_by_pose_sensor_are_two_columns(fly: Fly) -> None:
    configs = [
        f'{{"sensors": {sensors}, "markers": {markers}}}'
        for sensors, markers in (('"pose"', "null"), ('"camera"', "null"), ('"pose"', '"a.toml"'))
    ]
    logs = [fly(f"sensors-{n}", seed=n, config=config) for n, config in enumerate((*configs, configs[0]))]
    found = json.loads(call("compare", *logs, "--json")[1])
    assert [len(column) for column in found["columns"].values()] == [2, 1, 1]
    assert found["differences"] == ["B has sensors camera, not pose", "C has markers a.toml, not none"]


def test_logs_with_little_in_common_still_have_a_table(fly: Fly, two: tuple[Path, Path], tmp_path: Path) -> None:
    poor = fly("poor", truth=False, waypoints=(), obstacles=(), scenario="quay", vehicle="rov", tank_polygon_m=())
    bare = tmp_path / "bare.mcap"
    LogWriter(bare, epoch_ns=EPOCH_NS, metadata={}, attachments={}).close()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(two[0].read_bytes()[:-10])
    code, out = call("compare", two[0], poor, bare, "--json")
    found = json.loads(out)
    energy = next(row for row in found["figures"] if row["name"] == "energy of a lap, median")
    assert code == 0 and energy["values"]["B"] is None and energy["ratios"]["B"] is None
    notes = " ".join(found["not_comparable"])
    for part in ("paper-tank and quay", "tank, obstacles, plan", "the estimate", "the battery monitor", "no laps"):
        assert part in notes, notes
    assert "bare.mcap: has neither /sim/truth nor /nav/state" in notes
    lines = call("compare", two[0], poor, bare)[1].splitlines()
    assert next(line for line in lines if line.strip().startswith("laps")).split() == ["laps", "1", *"----"]
    code, out = call("compare", bare, bare)
    assert code == 0 and "not judged" in out
    code, out = call("compare", two[1], cut)
    assert code == 3 and "cut.mcap: damaged" in out


def test_many_columns_fit_and_none_is_cut(fly: Fly, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    logs = [fly(f"margin-{n}", parameters={"MPC_MARGIN": 0.01 * n}) for n in range(1, 8)]
    code, out = call("compare", *logs)
    assert code == 0 and max(map(len, out.splitlines())) <= 80 and "…" not in out
    assert all(f"{name} / A" in out for name in "BCDEFG")


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_tracks_are_drawn_into_one_plan(two: tuple[Path, Path], tmp_path: Path, ending: str) -> None:
    path = tmp_path / "new" / f"tracks.{ending}"
    code, out = call("compare", *two, "--figure", path)
    assert code == 0 and out.splitlines()[-1] == str(path) and path.stat().st_size > 5_000


def test_wrong_use_is_named(two: tuple[Path, Path], tmp_path: Path) -> None:
    assert call("compare", two[0])[0] == 2
    code, out = call("compare", two[0], tmp_path / "none.mcap")
    assert code == 1 and "none.mcap" in out
    code, out = call("compare", *two, "--figure", tmp_path / "a.doc")
    assert code == 1 and "give it the ending" in out
