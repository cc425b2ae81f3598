"""The estimator's benchmark: figures of made-up flights are known, scenarios are varied as told, one real flight."""

import math
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from autopilot.cli.bench import bench as bench_command
from autopilot.core.markers import grid_floor
from autopilot.core.messages import NavState, Outputs
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.toml_text import toml_text
from tests.bench import estimator as bench
from tests.bench import estimator_cost as cost
from tests.bench.estimator import PLAN, STEADY_S, judged
from tests.bench.estimator_figures import (
    Limit,
    Watched,
    current_rms,
    drift_m,
    error_rms,
    far_fixes,
    far_fixes_used,
    growth,
    inside_fraction,
    mean_nees,
    mean_nis,
    nees_band,
    nis_fraction,
    pooled_rms,
    recovery_s,
    verdict,
    whiteness,
)
from tests.bench.estimator_flights import SAME, SHIFTED, FlightSpec, fly, overlaid
from tests.bench.estimator_plots import draw_honesty
from tests.bench.laid_maps import (
    Camera,
    OverFloor,
    faulty_floor,
    laid_floor,
    over,
    plan_with_errors,
    record,
    sigma_of,
)
from tests.bench.laid_rows import LaidRun, laid_rows

SIGMA = np.array([0.002, 0.003, 0.001, 0.0005, 0.01, 0.02, 0.01])
SPAN_S = (0.0, 1e9)
POLYGON = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def made_up(n: int = 4000, seed: int = 1, scale: float = 1.0, seconds: float = 45.0) -> Watched:
    """A consistent estimator for ``scale`` 1; otherwise its errors are so much larger than it says."""
    rng = np.random.default_rng(seed)
    root = np.tril(rng.normal(0.0, 0.2, (7, 7)), -1) + np.eye(7)
    root = SIGMA[:, None] * root
    residual = rng.normal(size=(n, 4))
    return Watched(
        t_s=np.linspace(0.0, seconds, n),
        error=scale * rng.normal(size=(n, 7)) @ root.T,
        covariance=np.broadcast_to(root @ root.T, (n, 7, 7)),
        current_error=np.tile([0.03, -0.04], (n, 1)),
        fix_t_s=np.linspace(0.0, seconds, n),
        fix_used=np.ones(n, dtype=bool),
        fix_distance=np.square(scale * residual).sum(axis=1),
        fix_residual=scale * residual[:, :3],
        fix_off_m=np.zeros(n),
    )


def test_consistent_estimator_has_the_figures_of_the_chi_square_distribution() -> None:
    run = made_up()
    assert mean_nees(run, SPAN_S) == pytest.approx(7.0, abs=0.3)
    assert mean_nis(run, SPAN_S) == pytest.approx(4.0, abs=0.2)
    assert nis_fraction(run, SPAN_S) == pytest.approx(5.0, abs=1.2)
    assert whiteness(run, SPAN_S) < 0.06
    assert inside_fraction([run], [SPAN_S]) == pytest.approx(99.7, abs=0.3)
    sure = made_up(scale=2.0)
    assert mean_nees(sure, SPAN_S) == pytest.approx(28.0, abs=1.2)
    assert nis_fraction(sure, SPAN_S) > 40.0
    assert inside_fraction([sure], [SPAN_S]) < 90.0


def test_band_narrows_with_the_number_of_runs() -> None:
    band = nees_band(7, 20)
    assert (band.low, band.high) == pytest.approx((5.45, 8.74), abs=0.01)
    one = nees_band(7, 1)
    assert one.low < band.low < 7.0 < band.high < one.high


def test_rms_of_vectors_and_spans() -> None:
    run = replace(made_up(n=5), t_s=np.arange(5.0), error=np.tile([3.0, 4.0, 1.0, 0, 0, 0, 0], (5, 1)))
    run.error[4] = 100.0
    assert error_rms(run, slice(0, 2), (0.0, 3.0)) == pytest.approx(5.0)
    assert error_rms(run, slice(2, 3), (0.0, 3.0)) == pytest.approx(1.0)
    assert current_rms(run, SPAN_S) == pytest.approx(0.05)
    assert drift_m(run, 3.0) == pytest.approx(5.0)
    assert pooled_rms([3.0, 4.0]) == pytest.approx(math.sqrt(12.5))
    assert growth([0.013, 0.013], [0.010, 0.010]) == pytest.approx(30.0)


def test_residuals_that_follow_each_other_are_not_white() -> None:
    run = made_up(n=2000)
    slow = np.cumsum(run.fix_residual, axis=0)
    assert whiteness(replace(run, fix_residual=slow), SPAN_S) > 0.9
    rejected = replace(run, fix_residual=slow, fix_used=np.zeros(2000, dtype=bool))
    rejected.fix_used[:200:3] = True
    assert whiteness(rejected, (0.0, 1e9)) < whiteness(replace(run, fix_residual=slow), SPAN_S)


def test_far_fixes_are_counted_and_unknown_ones_are_not() -> None:
    run = made_up(n=4)
    run = replace(run, fix_off_m=np.array([0.0, 0.5, 0.5, np.nan]), fix_used=np.array([True, True, False, True]))
    assert far_fixes(run) == 2
    assert far_fixes_used(run) == 1


def moved(followed_s: float, back_s: float = math.inf) -> Watched:
    """Fixes move by 0.5 m at 10 s; the estimate follows at ``followed_s`` and is lost again at ``back_s``."""
    t_s = np.arange(0.0, 20.0, 0.05)
    error = np.zeros((len(t_s), 7))
    error[(t_s >= followed_s) & (t_s < back_s), 0] = 0.5
    return replace(made_up(n=len(t_s)), t_s=t_s, error=error)


def test_recovery_is_when_the_estimate_has_followed_for_good() -> None:
    assert recovery_s(moved(10.4), 10.0, 19.0, 0.5) == pytest.approx(0.4, abs=0.051)
    assert recovery_s(moved(10.0), 10.0, 19.0, 0.5) == 0.0
    assert recovery_s(moved(25.0), 10.0, 19.0, 0.5) == math.inf
    assert recovery_s(moved(10.4, back_s=18.0), 10.0, 19.0, 0.5) == math.inf
    assert recovery_s(moved(18.8), 10.0, 19.0, 0.5) == math.inf


def test_verdicts() -> None:
    bar, goal = Limit(high=6.0), Limit(high=3.0)
    assert [verdict(value, bar, goal) for value in (2.0, 3.0, 4.0, 7.0, math.nan)] == [
        *("goal", "goal", "bar", "missed", "missed")
    ]
    assert verdict(2.0, bar, None) == "bar"
    assert verdict(2.0, None, None) == ""
    assert (str(bar), str(Limit(low=95.0)), str(Limit(low=3.0, high=9.0))) == ("<= 6", ">= 95", "3 to 9")


plain = st.recursive(
    st.one_of(st.booleans(), st.integers(-1000, 1000), st.floats(-1e6, 1e6), st.text("abc \"\\'é", max_size=8)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text("abc_-", min_size=1, max_size=5), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(tables=st.dictionaries(st.text("abc_", min_size=1, max_size=5), plain, max_size=4))
def test_toml_says_what_the_tables_say(tables: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(tables)) == tables


def test_tables_are_merged_and_other_kinds_replaced() -> None:
    base = {"a": {"x": 1, "y": 2}, "current": {"kind": "jet", "speed_m_s": 0.25}, "fault": [1]}
    changed = overlaid(base, {"a": {"y": 3}, "current": {"kind": "none"}, "fault": [2], "b": {"z": 1}})
    assert changed == {"a": {"x": 1, "y": 3}, "current": {"kind": "none"}, "fault": [2], "b": {"z": 1}}
    assert base["a"] == {"x": 1, "y": 2}


@pytest.mark.parametrize("name", PLAN)
def test_every_flight_has_a_scenario_that_loads(name: str, tmp_path: Any) -> None:
    path = tmp_path / "varied.toml"
    from autopilot.sitl.scenario import scenario_path
    from tests.bench.estimator_flights import BASE

    changes, duration_s, sensors, watchers = PLAN[name]
    path.write_text(toml_text(overlaid(tomllib.loads(scenario_path(BASE).read_text()), changes)))
    scenario = load_scenario(str(path))
    assert duration_s >= STEADY_S[1]
    assert sensors in ("pose", "camera")
    assert watchers[0] == SAME
    shipped = load_scenario(BASE)
    assert (scenario != shipped) == bool(changes)
    assert scenario.tank == shipped.tank


def test_table_of_made_up_flights() -> None:
    runs = {
        name: [{watcher: made_up(seed=seed) for watcher in watchers} for seed in range(2)]
        for name, (_, _, _, watchers) in PLAN.items()
    }
    rows = {row.figure: row for row in judged(runs)}
    assert len(rows) == len(judged(runs))
    steady = rows["position, horizontal"]
    assert steady.verdict == "bar"
    assert steady.measured == pytest.approx(1e3 * math.hypot(*np.sqrt(np.diag(made_up().covariance[0]))[:2]), rel=0.1)
    assert rows["NEES of these 7 states"].verdict == "goal"
    assert rows["current, jet"].measured == pytest.approx(50.0)
    assert rows["current, jet"].verdict == "missed"
    for row in rows.values():
        if row.low is not None:
            assert row.median is not None
            assert row.high is not None
            assert row.low <= row.median <= row.high
    assert rows["pictures: position, horizontal"].low == pytest.approx(steady.low)
    assert rows["gap of 5 s, jet, pictures"].seeds == 2
    assert rows["current, uniform, 20 % less drag"].verdict == "bar"
    assert rows["gap of 5 s, uniform, no vehicle model"].verdict == ""
    assert rows["outliers 30 %: growth of horizontal error"].measured == pytest.approx(0.0)
    assert rows["all fixes shifted by 0.5 m and back: found again after"].verdict == "missed"
    assert rows["60 +- 20 ms late: position, delay ignored (must be bad)"].verdict == "missed"


@pytest.mark.long
def test_the_watching_filter_is_the_flown_one() -> None:
    """Same samples, same thrust: bit for bit the same states, through arming, blackout and wrong fixes."""
    ticks: list[tuple[NavState | None, NavState | None]] = []

    def compare(outputs: Outputs, watching: NavState | None) -> None:
        ticks.append((outputs.nav, watching))

    changes = {
        "sensors": {"pose": {"outlier_probability": 0.2}},
        "fault": [{"kind": "camera_blackout", "at_s": 3.0, "duration_s": 0.5}],
    }
    runs = fly(FlightSpec(name="x", changes=changes, duration_s=5.0, seed=3, watchers=(SAME, SHIFTED)), compare)
    assert len(ticks) == 500
    for flown, watching in ticks:
        assert (flown is None) == (watching is None)
        if flown is not None and watching is not None:
            assert flown.pos_ned_m.tolist() == watching.pos_ned_m.tolist()
            assert flown.variance.tolist() == watching.variance.tolist()
    run = runs[SAME]
    assert far_fixes(run) > 10
    assert far_fixes_used(run) == 0
    assert error_rms(run, slice(0, 2), (1.0, 3.0)) < 0.01
    assert run.covariance.shape == (len(run.t_s), 7, 7)
    assert not ((run.fix_t_s >= 3.0) & (run.fix_t_s < 3.5)).any()


def test_command_prints_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, chosen = [], []

    def fake(*seeds: range, groups: tuple[str, ...] | None, figures: str | None) -> list[Any]:
        chosen.append(groups)
        asked.append(seeds)
        runs = {name: [{watcher: made_up() for watcher in watchers}] for name, (_, _, _, watchers) in PLAN.items()}
        return judged(runs)

    monkeypatch.setattr(bench, "bench_estimator", fake)
    monkeypatch.setattr(cost, "bench_cost", lambda duration_s: [])
    done = CliRunner().invoke(bench_command, ["estimator", "--short"])
    assert done.exit_code == 0, done.output
    assert "NEES" in done.output
    assert "None" not in done.output
    assert CliRunner().invoke(bench_command, ["estimator", "--json"]).exit_code == 0
    assert CliRunner().invoke(bench_command, ["estimator", "--seeds", "201..220", "--only", "laid"]).exit_code == 0
    done = CliRunner().invoke(bench_command, ["estimator", "--only", "lid"])
    assert done.exit_code == 2
    assert "there is steady, pictures, " in done.output
    assert chosen == [None, None, ("laid",)]
    few, default, unseen = asked
    assert [len(seeds) for seeds in few] == [3, 1]
    assert [len(seeds) for seeds in default] == [20, 3]
    assert unseen == (range(201, 221), range(201, 221))
    assert not set(unseen[0]) & set(default[0])


@pytest.mark.parametrize("text", ["5", "..", "7..5", "a..b", "1..", "-1..3", "1..2..3", ""])
def test_bad_seeds_are_refused(text: str) -> None:
    done = CliRunner().invoke(bench_command, ["estimator", "--seeds", text])
    assert done.exit_code == 2
    assert "as in 201..220" in done.output


def test_seeds_belong_to_flights() -> None:
    for arguments in (["nmpc", "--seeds", "1..2"], ["estimator", "--images", "--seeds", "1..2"]):
        done = CliRunner().invoke(bench_command, arguments)
        assert done.exit_code == 2
        assert "belongs to" in done.output


def over_floor(xy_m: float, sigma_m: float, resets: int = 0) -> OverFloor:
    """An estimate that is off by so much in each axis and says so much."""
    n = 50
    markers = grid_floor(polygon_m=POLYGON, depth_m=1.0, pitch_m=0.1, size_m=0.06, seed=1)
    return OverFloor(
        t_s=np.arange(n) * 0.1,
        error=np.full((n, 4), xy_m),
        variance=np.full((n, 4), sigma_m**2),
        place_m=np.random.default_rng(1).normal(size=(n, 2)),
        resets=resets,
        refined=markers,
        remarks=(),
    )


def test_laid_floors_are_judged_by_every_bar() -> None:
    good, bad = over_floor(0.001, 0.001), over_floor(0.02, 0.001, 1)
    kept = laid_rows([LaidRun(rigid=((good, good),) * 3, printed=good, missing=(), false=())])
    assert not [row.figure for row in kept if row.verdict == "missed"]
    lost = laid_rows([LaidRun(rigid=((bad, bad),) * 3, printed=bad, missing=("ids swapped",), false=("Sheet 3",))])
    unjudged = [row.figure for row in lost if row.verdict != "missed"]
    assert len(unjudged) == 6
    assert all("worst" in figure or "but for one shift" in figure for figure in unjudged)
    assert bad.form_mm() < 1e-6, "all of it is one shift"


def test_flights_that_nobody_has_calibrated_are_drawn(tmp_path: Path) -> None:
    path = Path(draw_honesty([over_floor(0.001, 0.001), over_floor(0.02, 0.01)], str(tmp_path / "new")))
    assert path.name == "estimator-honesty.png"
    assert path.stat().st_size > 10_000


@pytest.mark.long
def test_a_recorded_flight_over_another_floor() -> None:
    recording = record(3, 6.5)
    camera = Camera(recording)
    exact = over(recording, camera, recording.plan, recording.plan, 1)
    assert len(exact.t_s) == 15
    assert exact.xy_mm() < 2.0
    ignorant, told = [], []
    for seed in (1, 2, 3):
        floor = laid_floor(recording.plan, np.random.default_rng(seed), sigma_of(0.0069))
        off = 1e3 * np.sqrt(((floor.centers_ned_m - recording.plan.centers_ned_m) ** 2).sum(axis=1).mean())
        assert off == pytest.approx(6.9, rel=0.25)
        unaware = over(recording, camera, floor, recording.plan, 1)
        aware = over(recording, camera, floor, plan_with_errors(recording.plan, None), 1)
        assert unaware.xy_mm() > 10.0 * aware.xy_mm()
        ignorant.append(unaware.nees(slice(0, 2)))
        told.append(aware.nees(slice(0, 2)))
    # A single floor may be kind to one flight.
    assert np.mean(ignorant) > 6.0 > np.mean(told)
    with pytest.raises(ValueError, match="record a longer one"):
        faulty_floor(recording, camera, recording.plan, floor, 1)
