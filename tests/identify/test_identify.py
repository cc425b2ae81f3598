"""Identification: known coefficients come back with intervals that hold; what is not told is kept."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from autopilot.calibrate.vehicle_edit import write_updated
from autopilot.cli.identify import identify
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import Model4
from autopilot.core.vehicle import load_vehicle
from autopilot.identify.fit import fit
from autopilot.identify.identification_report import changes, kept_axes, rows_of
from autopilot.identify.prediction import AXES, N_COMMON, CoefficientScale, predict
from autopilot.identify.record import STEP_S, WINDOW_STEPS, Windows
from autopilot.log.writer import LogWriter

VEHICLE = load_vehicle("lbv150")
BASE = VEHICLE.to_model()
TRUE = replace(
    BASE,
    mass_kg=(19.0, 19.5, 25.5, 0.36),
    linear_drag=(5.0, 5.0, 6.5, 0.25),
    quadratic_drag=(38.0, 46.0, 70.0, 0.9),
    buoyancy_excess_n=0.9,
)
NOISE = np.array([0.002, 0.002, 0.002, 0.002, 0.005])
"""x, y, z [m], yaw [rad], yaw rate [rad/s]."""


def flights(true: Model4, seed: int, idle: tuple[int, ...] = (), windows: int = 40) -> Windows:
    """Random thrust, changed every second, in a current; thrusters in ``idle`` are not used."""
    rng = np.random.default_rng(seed)
    thrust = rng.uniform(-8.0, 8.0, (windows, WINDOW_STEPS // 20, 4)).repeat(20, axis=1)
    thrust[:, :, list(idle)] = 0.0
    t_s = STEP_S * np.arange(WINDOW_STEPS)[:, None]
    # A surging vehicle that leans moves up and down as well.
    phase, lean_rad = t_s + np.array([0.0, 1.0]), 0.0 if idle else 0.05
    leaning = np.broadcast_to(lean_rad * np.hstack([np.sin(phase), np.cos(phase)]), (windows, WINDOW_STEPS, 4))
    inputs = np.concatenate([thrust, leaning], axis=2)
    start = np.zeros((windows, 8))
    start[:, 3] = rng.uniform(-3.0, 3.0, windows)
    start[:, [4, 5, 7]] = rng.normal(0.0, 0.15, (windows, 3))
    flight = np.arange(windows) % 2
    current: FloatArray = np.array([[0.05, -0.03], [0.0, 0.04]])[flight]
    motion = predict(CoefficientScale.of(true).base, BASE, start, inputs, current, STEP_S)
    return Windows(
        motion=motion + NOISE * rng.normal(size=motion.shape),
        start=start + rng.normal(0.0, 0.005, start.shape),
        inputs=inputs,
        flight=flight,
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_known_coefficients_come_back(seed: int) -> None:
    found = fit(flights(TRUE, seed), BASE)
    truth = CoefficientScale.of(TRUE).base
    off = (found.values - truth) / np.sqrt(np.diag(found.covariance))
    assert np.abs(off).max() < 4.5
    assert (np.abs(off) < found.student).mean() >= 0.7
    assert found.values[:4] == pytest.approx(truth[:4], rel=0.02)
    assert found.sigma == pytest.approx(NOISE, rel=0.1)
    assert found.current_m_s == pytest.approx(np.array([[0.05, -0.03], [0.0, 0.04]]), abs=0.002)
    assert not any(kept_axes(found))
    for row in rows_of(found, VEHICLE):
        if "drag at" in row.name:
            axis = AXES.index(row.name.split()[0])
            speed = float(row.name.split()[-1])
            drag = speed * TRUE.linear_drag[axis] + speed**2 * TRUE.quadratic_drag[axis]
            assert row.low < drag < row.high
            assert row.value == pytest.approx(drag, rel=0.05)


def test_an_axis_without_motion_keeps_its_values(tmp_path: Path) -> None:
    found = fit(flights(TRUE, 4, idle=(2,)), BASE)
    assert kept_axes(found) == (False, False, True, False)
    new = changes(found, VEHICLE)
    mass = new["model4.mass_kg"]
    assert isinstance(mass, list)
    assert mass[2] == BASE.mass_kg[2]
    assert mass[0] == pytest.approx(19.0, rel=0.02)
    target = tmp_path / "found.toml"
    write_updated("lbv150", new, "a test", target)
    written = load_vehicle(str(target))
    assert written.model4.mass_kg[0] == pytest.approx(19.0, rel=0.02)
    assert written.body.mass_kg + written.body.added_mass_kg[0] == pytest.approx(written.model4.mass_kg[0], abs=1e-3)
    assert written.body.inertia_kg_m2[2] + written.body.added_inertia_kg_m2[2] == pytest.approx(
        written.model4.mass_kg[3], abs=1e-3
    )


def test_prediction_agrees_with_itself_in_halves() -> None:
    """Two half windows, the second from the end of the first, are the whole."""
    data = flights(TRUE, 5, windows=10)
    values = CoefficientScale.of(TRUE).base
    assert len(values) == N_COMMON
    still = np.zeros((10, 2))
    whole = predict(values, BASE, data.start, data.inputs, still, STEP_S)
    half = predict(values, BASE, data.start, data.inputs[:, :40], still, STEP_S)
    assert half == pytest.approx(whole[:, :41])


def test_a_log_of_another_vehicle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "six.mcap"
    flown = msgspec.json.encode(load_vehicle("bluerov2"))
    LogWriter(path, epoch_ns=10**18, metadata={}, attachments={"vehicle.json": flown}).close()
    result = CliRunner().invoke(identify, [str(path), "--vehicle", "lbv150"])
    assert isinstance(result.exception, ConfigError)
    assert "was flown by" in str(result.exception) and VEHICLE.thrusters[0].name in str(result.exception)
    result = CliRunner().invoke(identify, [str(path), "--vehicle", "bluerov2"])
    assert isinstance(result.exception, LogError)


def test_a_log_counts_once(tmp_path: Path) -> None:
    path, link = tmp_path / "flight.mcap", tmp_path / "link.mcap"
    path.write_bytes(b"")
    link.symlink_to(path)
    result = CliRunner().invoke(identify, [str(path), str(link)])
    assert result.exit_code == 2 and "is given twice" in result.output


def test_a_log_that_is_no_flight_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    path.write_bytes(b"")
    result = CliRunner().invoke(identify, [str(path)])
    assert isinstance(result.exception, LogError)
    assert str(path) in str(result.exception)
