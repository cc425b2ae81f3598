"""The gridded truth: exact at its nodes, continuous, its own gradient and rate, and wrong files refused."""

from array import array
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import netcdf_file

from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import load_vehicle
from autopilot.sitl.current_fields import GridCurrent, current_field
from autopilot.sitl.grid_current import Grid, GridField, read_grid
from autopilot.sitl.plant import build_plant
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.scenario_tables import Scenario

RNG = np.random.default_rng(3)
AXES = ((0.0, 10.0, 25.0), (0.0, 2.0), (-2.0, -0.5, 1.0, 2.5), (-1.0, 0.0, 2.0))
NODES = RNG.uniform(-0.3, 0.3, (3, *(len(axis) for axis in AXES)))
FIELD = GridField(Grid(axes=AXES, values=tuple(array("d", component.tobytes()) for component in NODES)))
places = st.tuples(st.floats(-3.0, 3.5), st.floats(-2.0, 3.0), st.floats(-1.0, 3.0))


def test_nodes_are_met_exactly() -> None:
    for k, t_s in enumerate(AXES[0]):
        for i, depth in enumerate(AXES[1]):
            for m, north in enumerate(AXES[2]):
                for n, east in enumerate(AXES[3]):
                    assert FIELD.velocity((north, east, depth), t_s) == tuple(NODES[:, k, i, m, n])


@given(place=places, t_s=st.floats(-5.0, 30.0))
def test_the_field_stays_within_its_nodes_and_is_continuous(place: tuple[float, float, float], t_s: float) -> None:
    value = np.array(FIELD.velocity(place, t_s))
    assert (value <= NODES.max(axis=(1, 2, 3, 4)) + 1e-15).all()
    assert (value >= NODES.min(axis=(1, 2, 3, 4)) - 1e-15).all()
    near = FIELD.velocity((place[0] + 1e-9, place[1] - 1e-9, place[2] + 1e-9), t_s + 1e-9)
    np.testing.assert_allclose(near, value, atol=1e-8)


def _inside_a_cell(x: float, axis: tuple[float, ...]) -> bool:
    return min(abs(x - node) for node in axis) > 1e-4


@given(place=places, t_s=st.floats(-5.0, 30.0))
def test_gradient_and_rate_are_those_of_the_velocity(place: tuple[float, float, float], t_s: float) -> None:
    if not (_inside_a_cell(place[0], AXES[2]) and _inside_a_cell(place[1], AXES[3]) and _inside_a_cell(t_s, AXES[0])):
        return
    x, y, z = place
    h = 1e-5
    north = np.subtract(FIELD.velocity((x + h, y, z), t_s), FIELD.velocity((x - h, y, z), t_s)) / (2.0 * h)
    east = np.subtract(FIELD.velocity((x, y + h, z), t_s), FIELD.velocity((x, y - h, z), t_s)) / (2.0 * h)
    expected = (north[0], east[0], north[1], east[1])
    np.testing.assert_allclose(FIELD.gradient(place, t_s), expected, atol=1e-9)
    rate = np.subtract(FIELD.velocity(place, t_s + h), FIELD.velocity(place, t_s - h)) / (2.0 * h)
    np.testing.assert_allclose(FIELD.rate(place, t_s), rate, atol=1e-9)


NORTH, EAST = np.linspace(-3.0, 3.0, 7), np.linspace(-2.0, 2.0, 5)


def _write(path: Path, **change: object) -> Path:
    arrays = {
        "north_m": NORTH,
        "east_m": EAST,
        "current_north_m_s": np.full((7, 5), 0.1),
        "current_east_m_s": 0.02 * np.add.outer(NORTH, EAST),
    }
    kept = {name: values for name, values in {**arrays, **change}.items() if values is not None}
    if path.suffix == ".npz":
        np.savez(path, **kept)
    else:
        with netcdf_file(str(path), "w") as file:
            for name, length in (("north_m", 7), ("east_m", 5)):
                file.createDimension(name, length)
            for name, values in kept.items():
                dims = (name,) if name in ("north_m", "east_m") else ("north_m", "east_m")
                file.createVariable(name, "d", dims)[:] = values
    return path


def _scenario(folder: Path) -> Scenario:
    text = (
        '[scenario]\nname = "g"\ndescription = "g"\n[sensors]\nposition = "pose"\n'
        '[current]\nkind = "grid"\nfile = "maps/flow.npz"\n[vehicle]\nstart_m = [0.0, 0.0, 1.0]\n'
    )
    (folder / "g.toml").write_text(text)
    return load_scenario(str(folder / "g.toml"))


@pytest.mark.parametrize("suffix", ["npz", "nc"])
def test_both_formats_give_the_same_field(tmp_path: Path, suffix: str) -> None:
    field = GridField(read_grid(str(_write(tmp_path / f"flow.{suffix}"))))
    assert field.velocity((1.0, 0.5, 3.0), 7.0) == pytest.approx((0.1, 0.03, 0.0))
    assert field.gradient((1.2, 0.5, 3.0), 7.0) == pytest.approx((0.0, 0.0, 0.02, 0.02))
    assert field.rate((1.2, 0.5, 3.0), 7.0) == (0.0, 0.0, 0.0)


def test_a_scenario_names_its_grid_beside_itself_and_the_plant_drifts_with_it(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    _write(tmp_path / "maps" / "flow.npz", current_east_m_s=np.zeros((7, 5)))
    scenario = _scenario(tmp_path)
    assert isinstance(scenario.current, GridCurrent)
    assert scenario.current.file == str(tmp_path / "maps" / "flow.npz")
    assert current_field(scenario.current).velocity((0.0, 0.0, 1.0), 0.0) == pytest.approx((0.1, 0.0, 0.0))
    vehicle = load_vehicle("lbv150")
    plant = build_plant(scenario, vehicle)
    plant.advance(20_000_000, [0] * len(vehicle.thrusters))
    assert plant.truth.pos_ned_m[0] > 0.5
    assert plant.truth.current_ned_m_s == pytest.approx((0.1, 0.0, 0.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"north_m": None}, "`north_m` is missing"),
        ({"current_east_m_s": None}, "`current_east_m_s` is missing"),
        ({"east_m": EAST[::-1]}, "`east_m` must ascend"),
        ({"current_north_m_s": np.zeros((5, 7))}, r"shape \(5, 7\), its axes ask for \(7, 5\)"),
        ({"current_north_m_s": np.full((7, 5), np.nan)}, "`current_north_m_s` holds NaN"),
    ],
)
def test_a_wrong_grid_is_refused_by_name(tmp_path: Path, change: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        read_grid(str(_write(tmp_path / "flow.npz", **change)))
    assert "\n" not in str(caught.value)


def test_files_that_are_missing_or_something_else_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="not found"):
        read_grid(str(tmp_path / "nothing.npz"))
    for name in ("text.npz", "text.nc"):
        (tmp_path / name).write_text("north,east\n")
        with pytest.raises(ConfigError, match=r"neither \.npz nor NetCDF-3"):
            read_grid(str(tmp_path / name))
