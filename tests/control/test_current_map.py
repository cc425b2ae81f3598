"""Current maps: three formats with one meaning, exact interpolation, and files that are refused by name."""

import sys
from datetime import UTC, datetime
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import netcdf_file

from autopilot.control.current.current_map import CurrentMap, MapNodes
from autopilot.control.current.map_reading import load_current_map
from autopilot.core.errors import ConfigError

RNG = np.random.default_rng(11)
TIME, DEPTH = np.array([0.0, 60.0, 90.0]), np.array([0.0, 2.0])
NORTH, EAST = np.array([-2.0, -0.5, 1.0, 2.5]), np.array([-1.0, 0.0, 2.0])
U, V = RNG.uniform(-0.3, 0.3, (2, 3, 2, 4, 3))
"""East and north, axes time, depth, north, east."""


def _map() -> CurrentMap:
    return CurrentMap(
        MapNodes(
            name="x",
            digest="",
            time_s=TIME,
            depth_m=DEPTH,
            north_m=NORTH,
            east_m=EAST,
            current_ned_m_s=np.stack([V, U, np.zeros_like(U)], axis=-1),
        )
    )


MAP = _map()
ARRAYS: dict[str, np.ndarray] = {
    "time_s": TIME,
    "depth_m": DEPTH,
    "north_m": NORTH,
    "east_m": EAST,
    "current_north_m_s": V,
    "current_east_m_s": U,
}
DIMS = ("time_s", "depth_m", "north_m", "east_m")
points = st.lists(
    st.tuples(st.floats(-3.0, 4.0), st.floats(-2.0, 3.0), st.floats(-1.0, 4.0), st.floats(-20.0, 120.0)),
    min_size=1,
    max_size=8,
)


def _ask(at: list[tuple[float, float, float, float]]) -> tuple[np.ndarray, np.ndarray]:
    table = np.array(at)
    return np.ascontiguousarray(table[:, :3]), table[:, 3]


def test_nodes_are_met_exactly() -> None:
    k, i, m, n = (a.ravel() for a in np.indices(U.shape))
    pos = np.stack([NORTH[m], EAST[n], DEPTH[i]], axis=1)
    out = MAP.velocity(pos, TIME[k])
    assert (out[:, 0] == V.ravel()).all()
    assert (out[:, 1] == U.ravel()).all()
    assert not out[:, 2].any()


@given(points)
def test_between_the_nodes_it_stays_within_them_and_is_continuous(at: list[tuple[float, float, float, float]]) -> None:
    pos, t_s = _ask(at)
    value = MAP.velocity(pos, t_s)
    for component, nodes in ((0, V), (1, U)):
        assert (value[:, component] <= nodes.max() + 1e-12).all()
        assert (value[:, component] >= nodes.min() - 1e-12).all()
    np.testing.assert_allclose(MAP.velocity(pos + 1e-9, t_s - 1e-9), value, atol=1e-8)


@given(points)
def test_a_place_is_bounded_by_the_corners_of_its_own_cell(at: list[tuple[float, float, float, float]]) -> None:
    pos, t_s = _ask(at)
    value = MAP.velocity(pos, t_s)
    for p, t, v in zip(pos, t_s, value, strict=True):
        cut = []
        for axis, x in ((TIME, t), (DEPTH, p[2]), (NORTH, p[0]), (EAST, p[1])):
            k = min(max(int(np.searchsorted(axis, x, side="right")) - 1, 0), len(axis) - 2)
            cut.append(slice(k, k + 2))
        corners = V[tuple(cut)]
        assert corners.min() - 1e-12 <= v[0] <= corners.max() + 1e-12


@given(points)
def test_the_gradient_is_that_of_the_velocity(at: list[tuple[float, float, float, float]]) -> None:
    pos, t_s = _ask(at)
    kinks = [np.abs(pos[:, [j]] - axis).min(axis=1) for j, axis in enumerate((NORTH, EAST, DEPTH))]
    keep = np.min(kinks, axis=0) > 1e-4
    pos, t_s = pos[keep], t_s[keep]
    gradient = MAP.gradient(pos, t_s)
    for j in range(3):
        step = np.zeros(3)
        step[j] = 1e-5
        numeric = (MAP.velocity(pos + step, t_s) - MAP.velocity(pos - step, t_s)) / 2e-5
        np.testing.assert_allclose(gradient[:, :, j], numeric, atol=1e-9)


def test_drift_bounds_what_changes_between_two_times() -> None:
    pos = RNG.uniform((-2.0, -1.0, 0.0), (2.5, 2.0, 2.0), (50, 3))
    change = np.abs(MAP.velocity(pos, np.full(50, 75.0)) - MAP.velocity(pos, np.full(50, 20.0))).max()
    assert 0.0 < change <= MAP.drift_m_s(20.0, 75.0)
    assert MAP.drift_m_s(500.0, 900.0) == 0.0


def write_npz(path: Path, **change: object) -> Path:
    np.savez(path, **{name: values for name, values in {**ARRAYS, **change}.items() if values is not None})
    return path


def test_npz_netcdf3_and_netcdf4_mean_the_same(tmp_path: Path) -> None:
    """NetCDF-3 as HYCOM packs it: short integers with scale and fill value, dimensions in another order."""
    packed = np.round(U / 1e-4).astype(">i2")
    packed[0, 1, 3, 2] = -30000
    with netcdf_file(str(tmp_path / "a.nc"), "w") as file:
        for name, axis in zip(DIMS, (TIME, DEPTH, NORTH[::-1], EAST), strict=True):
            file.createDimension(name, len(axis))
            file.createVariable(name, "d", (name,))[:] = axis
        u = file.createVariable("water_u", "h", ("depth_m", "time_s", "north_m", "east_m"))
        u[:] = packed[:, :, ::-1].transpose(1, 0, 2, 3)
        u.scale_factor, u._FillValue, u.units = 1e-4, np.int16(-30000), "m/s"
        v = file.createVariable("water_v", "d", DIMS)
        v[:], v.units = 100.0 * V[:, :, ::-1], "cm/s"
    with h5netcdf.File(str(tmp_path / "a.nc4"), "w") as file:
        file.dimensions = {name: len(axis) for name, axis in zip(DIMS, (TIME, DEPTH, NORTH, EAST), strict=True)}
        for name, axis in zip(DIMS, (TIME, DEPTH, NORTH, EAST), strict=True):
            file.create_variable(name, (name,), data=axis)
        file.create_variable("v_northward", DIMS, data=V)
        file.create_variable("u_eastward", DIMS, data=U)
    pos = RNG.uniform((-2.0, -1.0, 0.0), (0.9, 2.0, 2.0), (30, 3))
    t_s = RNG.uniform(0.0, 90.0, 30)
    expected = MAP.velocity(pos, t_s)
    of_npz = load_current_map(write_npz(tmp_path / "a.npz"))
    assert (of_npz.velocity(pos, t_s) == expected).all()
    assert (load_current_map(tmp_path / "a.nc4").velocity(pos, t_s) == expected).all()
    of_nc = load_current_map(tmp_path / "a.nc")
    np.testing.assert_allclose(of_nc.velocity(pos, t_s), expected, atol=1e-4)
    assert len(of_npz.nodes.digest) == 64
    # The fill value is still water for a loop and a gap for a check.
    assert of_nc.velocity(np.array([[2.5, 2.0, 2.0]]), np.zeros(1)).tolist() == [[0.0, 0.0, 0.0]]
    assert of_nc.unknown(0.0, 5.0).tolist() == [[False, False], [False, False], [False, True]]
    assert not of_nc.unknown(0.0, 0.0).any()


def test_latitudes_are_placed_by_the_origin_and_dates_by_the_start(tmp_path: Path) -> None:
    with netcdf_file(str(tmp_path / "a.nc"), "w") as file:
        file.createDimension("time", 2)
        file.createDimension("lat", 3)
        file.createDimension("lon", 2)
        file.createVariable("lat", "d", ("lat",))[:] = [10.0, 10.001, 10.002]
        file.createVariable("lon", "d", ("lon",))[:] = [359.0, 359.001]
        time = file.createVariable("time", "d", ("time",))
        time[:], time.units = [24.0, 25.0], "hours since 2026-05-01 00:00:00"
        file.createVariable("uo", "d", ("time", "lat", "lon"))[:] = 0.1
        file.createVariable("vo", "d", ("time", "lat", "lon"))[:] = np.array([0.0, 0.2])[:, None, None]

    def to_local(lat: float, lon: float) -> tuple[float, float]:
        return 1e5 * (lat - 10.0), 1e5 * (lon + 1.0)

    first = load_current_map(tmp_path / "a.nc", to_local)
    np.testing.assert_allclose(first.nodes.north_m, [0.0, 100.0, 200.0], atol=1e-6)
    np.testing.assert_allclose(first.nodes.east_m, [0.0, 100.0], atol=1e-6)
    assert first.nodes.time_s.tolist() == [0.0, 3600.0]
    here = np.zeros((1, 3))
    assert first.velocity(here, np.array([1800.0]))[0] == pytest.approx([0.1, 0.1, 0.0])
    started = load_current_map(tmp_path / "a.nc", to_local, datetime(2026, 5, 2, 0, 15, tzinfo=UTC))
    assert started.velocity(here, np.array([0.0]))[0] == pytest.approx([0.05, 0.1, 0.0])
    with pytest.raises(ConfigError, match="latitudes need an origin"):
        load_current_map(tmp_path / "a.nc")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"current_east_m_s": None}, r"variable `current_east_m_s` is missing \(or water_u, .*\); add or rename it"),
        ({"north_m": None}, r"variable `north_m` is missing; give `north_m` and `east_m`"),
        ({"north_m": np.array([0.0, 1.0, 0.5, 2.0])}, r"`north_m` is not monotonic: \[1\] = 1, \[2\] = 0.5; sort"),
        ({"east_m": np.array([0.0, 1.0, 1.0])}, r"`east_m` is not monotonic: \[1\] = 1, \[2\] = 1"),
        ({"time_s": np.array([0.0, np.nan, 9.0])}, r"`time_s`\[1\] is nan; an axis needs finite"),
        (
            {"current_north_m_s": V[:, :, :3]},
            r"`current_north_m_s` has the shape .* ask for \(3, 2, 4, 3\)",
        ),
        ({"current_north_m_s": V + 9.9}, r"`current_north_m_s` reaches 10.\d+ m/s, 5 is plausible; correct the units"),
        ({"east_m": np.array([0.0]), "current_north_m_s": V[..., :1]}, r"`east_m` has 1 value\(s\), needs 2 or more"),
    ],
)
def test_a_wrong_map_is_refused_in_one_line(tmp_path: Path, change: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        load_current_map(write_npz(tmp_path / "m.npz", **change))
    assert "\n" not in str(caught.value)
    assert "m.npz" in str(caught.value)


def test_files_that_are_no_maps_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_current_map(tmp_path / "nothing.nc")
    for name, content, message in (
        ("text.npz", b"north,east", "neither"),
        ("cut.npz", write_npz(tmp_path / "whole.npz").read_bytes()[:200], "damaged"),
        ("cut.nc", b"CDF\x01\x00\x00", "damaged"),
        ("cut.nc4", b"\x89HDF\r\n\x1a\n" + bytes(40), "damaged"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ConfigError, match=message) as caught:
            load_current_map(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_without_the_extra_hdf5_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.nc").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(40))
    monkeypatch.setitem(sys.modules, "h5netcdf", None)
    with pytest.raises(ConfigError, match=r"pip install 'underwater-autopilot\[currents\]'"):
        load_current_map(tmp_path / "a.nc")
