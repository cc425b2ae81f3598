"""The attitude filter's benchmark: its motions agree with their sensors, choices leave out what they are tried on."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from autopilot.cli.bench import bench as bench_command
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.estimator.attitude import AttitudeFilter
from autopilot.estimator.rotation import IDENTITY, product, rotation_by, rows, turn_between
from tests.bench import attitude as bench
from tests.bench.attitude import AttitudeRow, bench_attitude, best_without, errors_of, median_inclination
from tests.bench.attitude_fixed import FixedGainFilter, FixedGains
from tests.bench.attitude_motions import FAMILIES, record
from tests.bench.attitude_recordings import load_trials


@pytest.mark.parametrize("family", FAMILIES)
def test_sensors_of_a_motion_agree_with_its_attitude(family: str) -> None:
    """Gyros alone keep the attitude for 4 s, up to their bias; the mean force is that of gravity."""
    motion = record(family, 5, 20.0)
    q, step_s = IDENTITY, 1.0 / motion.rate_hz
    rates = motion.rate_frd_rad_s.tolist()
    for n in range(500, 900):
        q = product(q, rotation_by(turn_between(tuple(rates[n]), tuple(rates[n + 1]), step_s)))
    turned = motion.true[100].T @ motion.true[180]
    off = math.acos(min(1.0, 0.5 * (np.trace(turned.T @ np.array(rows(q))) - 1.0)))
    assert off < math.radians(4.0 * 1.5 + 1.0)
    force = np.einsum("nij,nj->ni", motion.true, motion.accel_frd_m_s2[::5]).mean(axis=0)
    assert force[2] == pytest.approx(-9.81, abs=0.4)
    assert np.abs(force[:2]).max() < 0.8
    assert (record(family, 5, 20.0).mag_frd == motion.mag_frd).all()
    assert (record(family, 6, 20.0).mag_frd != motion.mag_frd).any()


def test_errors_are_those_of_the_rotation() -> None:
    class Off:
        """Knows the truth and is off by a known rotation."""

        def __init__(self, rpy_rad: FloatArray) -> None:
            self.rpy_rad = rpy_rad

        def step(self, sample: object) -> FloatArray:
            return self.rpy_rad

    motion = record("tour", 1, 20.0)
    still = replace(motion, true=np.broadcast_to(np.eye(3), motion.true.shape))
    roll = errors_of(still, Off(np.array([math.radians(2.0), 0.0, 0.0])))
    assert (roll.inclination, roll.total) == pytest.approx((2.0, 2.0))
    assert roll.heading == pytest.approx(0.0, abs=0.1)
    yaw = errors_of(still, Off(np.array([0.0, 0.0, math.radians(-3.0)])))
    assert (yaw.heading, yaw.total) == pytest.approx((3.0, 3.0))
    assert yaw.inclination == pytest.approx(0.0, abs=1e-6)


def test_the_choice_does_not_see_what_it_is_tried_on() -> None:
    costs = [{"a": 0.0, "b": 5.0, "c": 5.0}, {"a": 9.0, "b": 1.0, "c": 1.0}]
    assert [best_without(group, costs) for group in ("a", "b", "none")] == [1, 0, 0]


def test_filters_beside_each_other_on_motions_nobody_saw(tmp_path: Path) -> None:
    """The real rows of two families; no trials in the folder."""
    for family in ("swell", "passing magnet"):
        motion = record(family, 777, 60.0)
        ours, fixed = errors_of(motion, AttitudeFilter()), errors_of(motion, FixedGainFilter(FixedGains()))
        assert ours.inclination < 1.1 * fixed.inclination
        assert ours.total < 1.1 * fixed.total
    assert load_trials(tmp_path) == ()


def test_another_file_is_no_trial(tmp_path: Path) -> None:
    np.savez(tmp_path / "trial_99_other.npz", something=np.zeros(3))
    with pytest.raises(LogError, match=r"trial_99_other.*SOURCES"):
        load_trials(tmp_path)


def row(inclination: float = 0.5, missed: str = "") -> AttitudeRow:
    return AttitudeRow(
        trial="made up",
        inclination=inclination,
        heading=1.0,
        total=1.2,
        fixed_inclination=1.0,
        fixed_heading=2.0,
        fixed_total=2.2,
        vqf_inclination=None,
        vqf_heading=None,
        vqf_total=None,
        chosen="",
        missed=missed,
    )


@pytest.mark.parametrize(
    ("rows", "code"), [([row()], 0), ([row(), row(missed="total")], 1), ([row(1.5), row(1.5), row()], 1)]
)
def test_command_prints_and_judges(
    rows: list[AttitudeRow], code: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[Any] = []

    def fake(short: bool, folder: Path, seeds: range | None) -> list[AttitudeRow]:
        asked.append((short, folder, seeds))
        return rows

    monkeypatch.setattr(bench, "bench_attitude", fake)
    arguments = ["estimator", "--attitude", "--short", "--data", str(tmp_path), "--seeds", "7..9"]
    done = CliRunner().invoke(bench_command, arguments)
    assert done.exit_code == code, done.output
    assert asked == [(True, tmp_path, range(7, 10))]
    assert f"median inclination {median_inclination(rows):.2f} deg" in done.output
    assert "no recorded trials" in done.output
    assert CliRunner().invoke(bench_command, ["nmpc", "--attitude"]).exit_code == 2


def test_short_table_is_made_by_the_real_thing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(bench, "FAMILIES", {"tour": FAMILIES["tour"]})
    (only,) = bench_attitude(True, tmp_path, range(5, 6), workers=1)
    assert only.trial == "tour, 1 seeds"
    assert 0.0 < only.inclination < 2.0
    assert only.vqf_total is None
