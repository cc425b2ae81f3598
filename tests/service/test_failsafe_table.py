"""The table of failsafes: whole, documented, and evaluated as it says."""

import math
from pathlib import Path

import numpy as np
import pytest
from commander_bench import OK, Bench
from hypothesis import given
from hypothesis import strategies as st

from autopilot.command.failsafe_docs import failsafe_texts, with_table
from autopilot.command.failsafe_table import EFFECTS, RANK, ROWS, FailsafeRow
from autopilot.core.messages import Failsafe, NavDoubt
from autopilot.core.params import PARAMETERS, ParamSet
from autopilot.core.samples import HullSample, LeakSample
from autopilot.mavlink.api import CommandResult, FlightMode

PAGE = Path(__file__).parents[2] / "docs" / "failsafes.md"


def test_every_failsafe_has_one_row() -> None:
    assert sorted(row.rule for row in ROWS) == list(Failsafe)
    assert {effect for row in ROWS for effect in row.effects} <= set(EFFECTS) == set(RANK)


def test_the_page_holds_the_programs_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text == with_table(text), "autopilot failsafes --write docs/failsafes.md"
    assert not [row.message for row in failsafe_texts() if "{" in row.message]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.rule.name)
def test_a_rows_parameters_exist_and_its_texts_fit_an_operators_line(row: FailsafeRow) -> None:
    params = ParamSet()
    assert all(name in params for name in (row.enter, row.enter_s) if isinstance(name, str))
    assert len(f"Failsafe: {row.text}") <= 50 or "{" in row.text
    if row.action:
        spec = params.spec(row.action)
        assert (spec.minimum, spec.maximum) == (0, len(row.effects) - 1)
    else:
        assert len(row.effects) == 1


def test_every_failsafe_parameter_is_looked_at_by_a_row() -> None:
    named = " ".join(f"{row.enter} {row.enter_s} {row.action} {row.condition}" for row in ROWS)
    others = {"FS_FAULT_TIME", "FS_OVERRIDE"}
    assert [s.name for s in PARAMETERS if s.name.startswith("FS_") and s.name not in named] == sorted(others)


def raise_row(bench: Bench, name: str) -> None:
    """Make a condition true that has no time of its own."""
    if name == "leak":
        bench.status.wet_us = math.inf
    elif name == "battery":
        bench.remaining = 0.08
    elif name == "solver":
        bench.status.solver_failures = 1000
    elif name == "late":
        bench.status.command_delay_s = 1.0
    elif name == "gcs":
        bench.status.gcs_us = -math.inf


def end_row(bench: Bench, name: str) -> None:
    bench.status.wet_us = bench.status.wet_us if name != "leak" else math.nan
    bench.status.gcs_us = bench.status.gcs_us if name != "gcs" else math.nan
    bench.remaining = bench.remaining if name != "battery" else 0.9
    bench.status.solver_failures = bench.status.solver_failures if name != "solver" else 0
    bench.status.command_delay_s = bench.status.command_delay_s if name != "late" else 0.0


STORY = {
    "leak": ("FS_LEAK_ENABLE", ("off", "warn", "surface", "drop")),
    "battery": ("FS_BATT_ACT", ("warn", "hold", "surface", "return", "disarm", "drop", "hand back")),
    "solver": ("FS_SOLVER_ACT", ("warn", "hold", "surface", "return", "disarm", "drop", "hand back")),
    "late": ("FS_LAT_ACT", ("warn", "hold", "surface", "return", "disarm", "drop", "hand back")),
    "gcs": ("FS_GCS_ENABLE", ("off", "warn", "disarm", "hold", "surface", "return")),
}


@given(st.data())
def test_the_most_severe_of_several_wins_and_does_not_weaken(data: st.DataObject) -> None:
    params, effects = {}, {}
    for name, (param, choices) in STORY.items():
        number = data.draw(st.integers(0, len(choices) - 1), label=param)
        params[param], effects[name] = float(number), choices[number]
    bench = Bench(**params).armed()
    worst, present = 0, set()
    for _ in range(data.draw(st.integers(1, 8), label="changes")):
        name = data.draw(st.sampled_from(sorted(STORY)), label="which")
        if name in present:
            end_row(bench, name)
            present.discard(name)
        else:
            raise_row(bench, name)
            present.add(name)
            worst = max(worst, RANK[effects[name]])  # type: ignore[index]
        decision = bench.run(0.03)
        if worst >= RANK["hand back"]:
            assert not decision.armed and decision.hand_back is (worst == RANK["hand back"])
            return
        assert decision.armed
        assert decision.drop_weight is (worst == RANK["drop"])
        modes = {0: FlightMode.HOLD, 1: FlightMode.HOLD, 2: FlightMode.RETURN}
        assert decision.mode is modes.get(worst, FlightMode.SURFACE)
        acts = any(RANK[effects[n]] > 0 for n in present)  # type: ignore[index]
        refused = bench.commander.set_mode(decision.mode).result is CommandResult.DENIED if worst and acts else None
        assert refused is None or refused is (decision.mode is not FlightMode.SURFACE)


def test_a_row_begins_after_its_time_and_ends_with_its_hysteresis() -> None:
    bench = Bench(FS_PRESS_MAX=100_000.0).armed()
    bench.status.hull_pa = 100_000.0
    assert bench.run(1.95).failsafes == 0
    assert bench.run(0.1).failsafes == 1 << Failsafe.PRESSURE
    bench.status.hull_pa = 99_600.0
    assert bench.run(3.0).failsafes == 1 << Failsafe.PRESSURE
    bench.status.hull_pa = 99_400.0
    assert bench.run(0.02).failsafes == 0
    assert [text for text in bench.texts if "hull" in text] == [
        "Failsafe: hull pressure high: check for leaks",
        "Failsafe over: hull pressure high: check for leaks",
    ]


def test_a_sensor_that_has_spoken_and_falls_silent_is_named() -> None:
    bench = Bench().armed()
    bench.status.note_sample(bench.t_us, HullSample(t_us=0, pressure_pa=None, temperature_c=20.0))
    assert bench.run(2.8).failsafes == 0
    assert bench.run(0.4).failsafes == 1 << Failsafe.SENSOR
    assert "Failsafe: hull sensor silent or frozen" in bench.texts


def test_a_leak_that_comes_and_goes_is_one() -> None:
    bench = Bench().armed()
    for wet in (True, False, True, False):
        bench.status.note_sample(bench.t_us, LeakSample(t_us=bench.t_us, wet=wet))
        assert bench.run(0.5).failsafes == 1 << Failsafe.LEAK
    assert bench.texts.count("Failsafe: water in the hull") == 1
    assert bench.run(2.0).failsafes & 1 << Failsafe.LEAK == 0


def test_the_operator_overrides_a_failsafe_and_that_is_recorded() -> None:
    bench = Bench(FS_LEAK_ENABLE=2)
    bench.armed()
    bench.status.wet_us = math.inf
    assert bench.run(0.02).mode is FlightMode.SURFACE
    assert bench.commander.set_mode(FlightMode.HOLD).result is CommandResult.DENIED
    bench.params.set("FS_OVERRIDE", float(1 << Failsafe.LEAK))
    bench.run(0.02)
    assert "Operator overrides failsafes: LEAK" in bench.texts
    assert bench.commander.set_mode(FlightMode.HOLD).result is OK
    decision = bench.run(1.0)
    assert decision.mode is FlightMode.HOLD and decision.failsafes == 1 << Failsafe.LEAK
    bench.params.set("FS_OVERRIDE", 0.0)
    assert bench.run(0.02).mode is FlightMode.SURFACE


def test_an_override_is_told_at_every_arming() -> None:
    bench = Bench(FS_OVERRIDE=float(1 << Failsafe.GCS)).armed()
    bench.run()
    bench.commander.disarm(False)
    bench.run()
    assert bench.commander.arm(force=False).result is OK
    bench.run()
    assert bench.texts.count("Operator overrides failsafes: GCS") == 2


def test_return_without_a_home_that_can_be_reached_holds() -> None:
    bench = Bench(FS_LAT_ACT=3)
    bench.load().armed()
    bench.plans.set_home(np.array([50.0, 0.0, 0.0]))
    bench.status.command_delay_s = 1.0
    assert bench.run(0.02).mode is FlightMode.HOLD


def test_doubts_raise_their_row_and_a_wrong_sensor_does_not() -> None:
    bench = Bench().armed()
    bench.status.nav_doubts = frozenset({NavDoubt.ACCELEROMETER})
    assert bench.run(1.2).failsafes == 0
    bench.status.nav_doubts = frozenset({NavDoubt.MAP})
    assert bench.run(1.2).failsafes == 1 << Failsafe.DOUBT


@pytest.mark.parametrize(
    ("params", "fixed", "doubts", "modes"),
    [
        ({}, True, (), ("HOLD", "HOLD", "SURFACE")),
        ({"FS_AHRS_TIME": 20.0}, True, (), ("HOLD", "HOLD", "HOLD")),
        ({"FS_AHRS_TIME": 0.0}, True, (), ("SURFACE",) * 3),
        ({}, False, (), ("SURFACE",) * 3),
        *(({}, True, (doubt,), ("SURFACE",) * 3) for doubt in (NavDoubt.FIXES, NavDoubt.RESETS, NavDoubt.CAMERA)),
        ({}, True, (NavDoubt.GYRO,), ("HOLD", "HOLD", "SURFACE")),
        ({"FS_AHRS_ACT": 0.0}, True, (), ("MISSION",) * 3),
        ({"FS_AHRS_ACT": 1.0}, False, (), ("HOLD",) * 3),
        ({"FS_AHRS_ACT": 3.0}, True, (), ("HOLD", "HOLD", "RETURN")),
        ({"FS_OVERRIDE": float(1 << Failsafe.AHRS_STALE)}, False, (), ("MISSION",) * 3),
    ],
)
def test_without_the_ahrs_it_holds_first_where_the_position_is_known(
    params: dict[str, float], fixed: bool, doubts: tuple[NavDoubt, ...], modes: tuple[str, ...]
) -> None:
    bench = Bench(**params)
    bench.load().armed()
    assert bench.commander.start_mission(None).result is OK
    bench.status.fixed, bench.status.nav_doubts = fixed, frozenset(doubts)
    bench.status.ahrs_age_s = 0.6
    assert tuple(bench.run(seconds).mode.name for seconds in (0.02, 4.9, 0.2)) == modes


def test_without_the_ahrs_it_surfaces_when_the_fixes_end_and_a_new_time_counts_at_once() -> None:
    bench = Bench(FS_AHRS_TIME=60.0).armed()
    bench.status.fixed, bench.status.ahrs_age_s = True, 0.6
    assert bench.run(10.0).mode is FlightMode.HOLD
    bench.params.set("FS_AHRS_ACT", 0.0)
    bench.params.set("FS_AHRS_ACT", 2.0)
    assert bench.run(0.02).mode is FlightMode.HOLD
    bench.status.fixed = False
    assert bench.run(0.02).mode is FlightMode.SURFACE
    bench.status.fixed = True
    assert bench.run(1.0).mode is FlightMode.SURFACE
