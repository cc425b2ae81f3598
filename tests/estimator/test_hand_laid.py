"""Marker maps as people lay them: sheets that are off, markers that have moved, ids that were mixed up."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from laid_world import LaidWorld, flown, laid, off_mm, sheets_of, turned
from makers import Make

from autopilot.core.frames import FloatArray
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import NavDoubt, NavHealth
from autopilot.estimator.gauge import common_columns, laid_scales
from autopilot.estimator.ground import SheetDependence, SheetTies, columns_of
from autopilot.estimator.inertial import Inertial, InertialStep, ProcessNoiseMode
from autopilot.estimator.kalman import KalmanCore
from autopilot.estimator.measure_heading import heading_of
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.sheet_fit import scatter
from autopilot.estimator.states import NX, FilterState

FLIGHT_S = 13.0
"""There and back: the way back is flown over what the way there has shown."""


@pytest.mark.parametrize(
    ("place_m", "turn_rad", "said", "seed", "bar_mm"),
    [
        (0.0045, 0.012, (0.0045, 0.012), 2, 10.0),
        (0.002, 0.006, None, 3, 6.0),
    ],
)
def test_a_hand_laid_floor(
    make_ekf: Make,
    floor: MarkerMap,
    place_m: float,
    turn_rad: float,
    said: tuple[float, float] | None,
    seed: int,
    bar_mm: float,
) -> None:
    """Sheets that are off cost millimetres and no resets; the filter knows how many, and the map becomes better."""
    told = sheets_of(floor, said)
    true = laid(told, np.random.default_rng(seed), place_m, turn_rad)
    estimator = make_ekf(markers=told)
    track, remarks = flown(estimator, LaidWorld(true, seed), FLIGHT_S)
    track = track.after(3.0)
    error = track.pos_error()[:, :2]
    variance = np.array([nav.variance[:2] for nav in track.nav])
    assert 1e3 * np.sqrt((error**2).sum(axis=1).mean()) < bar_mm
    assert (error**2 / variance).sum(axis=1).mean() < 6.0, "2 degrees of freedom, nearly one draw"
    assert estimator.counters()["resets"] == 0
    assert estimator.counters()["markers.rejected"] < 5
    assert remarks == []
    refined = estimator.refined_map
    assert refined is not None
    assert refined.errors is not None
    assert told.errors is not None
    assert (refined.errors.sigma[:, 2] == told.errors.sigma[:, 2]).all(), "depths are not refined on a level floor"
    if said is None:
        assert (error**2 / variance).sum(axis=1).mean() > 0.4, "the default is 2.5 times as much: the scatter tells"
    seen = (refined.errors.sigma[:, 3] < 0.2 * told.errors.sigma[:, 3])[refined.errors.sheet]
    assert seen.sum() > 200
    assert off_mm(refined, true, seen) < max(0.55 * off_mm(told, true, seen), 0.5)


def test_a_new_sheet_is_not_held_against_the_position(make_ekf: Make, floor: MarkerMap) -> None:
    """At the start nothing is known: neither the pose nor the sheets that come into view one after the other."""
    told = sheets_of(floor, (0.0042, 0.0146))
    worst_mm = []
    for seed in range(12):
        true = laid(told, np.random.default_rng(seed), 0.0042, 0.0146)
        track, _ = flown(make_ekf(markers=told), LaidWorld(true, seed), 0.8)
        worst_mm.append(1e3 * float(np.abs(track.pos_error()[:, :2]).max()))
    assert max(worst_mm) < 12.0, worst_mm


@pytest.mark.parametrize("seed", [1, 2])
def test_a_floor_with_sheets_that_are_far_off_costs_no_position(make_ekf: Make, floor: MarkerMap, seed: int) -> None:
    """A third of them lie several standard deviations off. One that the solver kept made the filter reject all pictures
    of it and its neighbours, and then the camera was called wrong."""
    rng = np.random.default_rng(seed)
    told = sheets_of(sparse(floor, 2, None), (0.004, 0.010))
    true = laid(told, rng, 0.004, 0.010)
    assert told.errors is not None
    corners = true.corners_ned_m.copy()
    for k in range(len(told.errors.names)):
        mine, way_rad = told.errors.sheet == k, rng.uniform(-math.pi, math.pi)
        if rng.random() < 0.33:
            shift_m = 0.028 * np.array([math.cos(way_rad), math.sin(way_rad), 0.0])
            corners[mine] = turned(corners[mine], 0.0, shift_m)
    estimator = make_ekf(markers=told)
    track, _ = flown(estimator, LaidWorld(dataclasses.replace(true, corners_ned_m=corners), seed), FLIGHT_S)
    assert estimator.counters()["doubt.camera"] == estimator.counters()["resets"] == 0
    lost = [nav.health is not NavHealth.GOOD for nav in track.after(3.0).nav]
    assert sum(lost) < 50, "half a second"
    assert 1e3 * np.abs(track.after(3.0).pos_error()[:, :2]).max() < 60.0


def test_a_moved_marker_is_named(make_ekf: Make, floor: MarkerMap) -> None:
    told = sheets_of(floor, (0.002, 0.006))
    moved = int(np.hypot(floor.centers_ned_m[:, 0] + 1.2, floor.centers_ned_m[:, 1] + 0.3).argmin())
    for markers in (floor, told):  # exact, and of sheets
        corners = markers.corners_ned_m.copy()
        corners[moved, :, 1] += 0.03
        true = dataclasses.replace(markers, corners_ned_m=corners, errors=None)
        estimator = make_ekf(markers=markers)
        track, remarks = flown(estimator, LaidWorld(true, 5), 7.0)
        assert remarks == [f"Marker {floor.ids[moved]} lies 3.0 cm east of its map place"]
        assert len(remarks[0]) <= 50
        assert any(NavDoubt.MAP in nav.doubts for nav in track.nav)
        assert 1e3 * np.abs(track.after(3.0).pos_error()[:, :2]).max() < 10.0


def sparse(floor: MarkerMap, every: int, sigma: tuple[float, float] | None) -> MarkerMap:
    """Every so many of the floor's markers, exact or of sheets that are laid so well."""
    some = np.arange(len(floor.ids)) % every == 0
    few = dataclasses.replace(floor, ids=floor.ids[some], corners_ned_m=floor.corners_ned_m[some])
    return few if sigma is None else sheets_of(few, sigma)


@pytest.mark.parametrize("scale", [0.93, 1.08])
@pytest.mark.parametrize("sigma", [None, (0.002, 0.006)], ids=["exact", "sheets"])
def test_squares_of_another_size_are_named_and_corrected(
    make_ekf: Make, floor: MarkerMap, sigma: tuple[float, float] | None, scale: float
) -> None:
    """One marker shows a height by its size, several by how far they are apart: without a correction fixes jump."""
    told = sparse(floor, 6, sigma)
    middles = told.centers_ned_m[:, None]
    true = dataclasses.replace(told, corners_ned_m=middles + scale * (told.corners_ned_m - middles), errors=None)
    estimator = make_ekf(markers=told)
    track, remarks = flown(estimator, LaidWorld(true, 5), FLIGHT_S)
    assert [remark[:20] for remark in remarks] == ["Markers are printed "] and len(remarks[0]) <= 50
    assert float(remarks[0].split()[3]) == pytest.approx(100.0 * abs(scale - 1.0), abs=1.0)
    assert 1e3 * np.abs(track.after(3.0).pos_error()).max() < 10.0
    assert estimator.counters()["markers.rejected"] < 5


@pytest.mark.parametrize("depth_m", [0.65, 0.75, 0.85])
@pytest.mark.parametrize("sigma", [None, (0.002, 0.006)], ids=["exact", "sheets"])
def test_a_moved_marker_among_few_is_named_and_costs_nothing(
    make_ekf: Make, floor: MarkerMap, sigma: tuple[float, float] | None, depth_m: float
) -> None:
    """Three to eight are in view of a vehicle that holds still: one that is off drags the pose, or prevents a start."""
    told = sparse(floor, 2, sigma)
    near = np.hypot(told.centers_ned_m[:, 0] + 1.6, told.centers_ned_m[:, 1] + 0.35).argsort()
    for moved in near[:2].tolist():
        corners = told.corners_ned_m.copy()
        corners[moved, :, :2] += (0.024, 0.018)
        estimator = make_ekf(markers=told)
        world = LaidWorld(dataclasses.replace(told, corners_ned_m=corners, errors=None), 5, rest_us=10_000_000)
        world.d = depth_m
        track, remarks = flown(estimator, world, 3.0)
        assert len(remarks) == 1 and remarks[0].startswith(f"Marker {told.ids[moved]} lies 3.")
        assert 1e3 * np.abs(track.after(1.0).pos_error()[:, :2]).max() < 8.0


@pytest.mark.parametrize("quarters", [1, 2, 3])
@pytest.mark.parametrize("sigma", [None, (0.002, 0.006)], ids=["exact", "sheets"])
def test_a_turned_marker_is_named_and_costs_nothing(
    make_ekf: Make, floor: MarkerMap, sigma: tuple[float, float] | None, quarters: int
) -> None:
    """It lies at its place: it was left out without a word."""
    told = sparse(floor, 3, sigma)
    turned_one = int(np.hypot(told.centers_ned_m[:, 0] + 1.6, told.centers_ned_m[:, 1] + 0.35).argmin())
    corners = told.corners_ned_m.copy()
    corners[turned_one] = np.roll(corners[turned_one], quarters, axis=0)
    world = LaidWorld(dataclasses.replace(told, corners_ned_m=corners, errors=None), 5, rest_us=10_000_000)
    world.d = 0.65
    track, remarks = flown(make_ekf(markers=told), world, 2.0)
    turn_deg = 180 if quarters == 2 else 90
    assert remarks == [f"Marker {told.ids[turned_one]} is turned by {turn_deg} deg against the map"]
    assert 1e3 * np.abs(track.after(1.0).pos_error()[:, :2]).max() < 8.0


def test_swapped_ids_are_named(make_ekf: Make, floor: MarkerMap) -> None:
    a, b = np.argsort(np.hypot(floor.centers_ned_m[:, 0] + 1.2, floor.centers_ned_m[:, 1] + 0.3))[[0, 6]]
    ids = floor.ids.copy()
    ids[[a, b]] = ids[[b, a]]
    estimator = make_ekf(markers=floor)
    _, remarks = flown(estimator, LaidWorld(dataclasses.replace(floor, ids=ids), 6), 7.0)
    pair = {f"Markers {x} and {y} are swapped in the map" for x, y in (ids[[a, b]], ids[[b, a]])}
    assert len(remarks) == 1
    assert remarks[0] in pair


def test_a_turned_sheet_is_named_and_its_place_found(make_ekf: Make, floor: MarkerMap) -> None:
    """By 5 degrees, where half a degree was said."""
    told = sheets_of(floor, (0.002, 0.006))
    assert told.errors is not None
    near = int(np.hypot(floor.centers_ned_m[:, 0] + 0.3, floor.centers_ned_m[:, 1] - 0.2).argmin())
    sheet = int(told.errors.sheet[near])
    true = laid(told, np.random.default_rng(4), 0.002, 0.006)
    corners = true.corners_ned_m.copy()
    mine = told.errors.sheet == sheet
    corners[mine] = turned(corners[mine], math.radians(5.0), np.zeros(3))
    true = dataclasses.replace(true, corners_ned_m=corners)
    estimator = make_ekf(markers=told)
    track, remarks = flown(estimator, LaidWorld(true, 7), 10.0)
    assert len(remarks) == 1
    assert remarks[0].startswith(f"Sheet {told.errors.names[sheet]} lies ")
    assert remarks[0].endswith("deg off the map")
    assert estimator.counters()["resets"] == 0
    assert 1e3 * np.abs(track.after(3.0).pos_error()[:, :2]).max() < 15.0
    refined = estimator.refined_map
    assert refined is not None
    assert off_mm(refined, true, mine) < 3.0 < off_mm(told, true, mine)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.1, 3.0), st.floats(0.1, 3.0), st.integers(8, 40))
def test_how_well_sheets_were_laid_shows(seed: int, place: float, turn: float, count: int) -> None:
    """By their scatter about what they have in common, which is no part of it."""
    rng = np.random.default_rng(seed)
    pivots = np.append(rng.uniform(-2.0, 2.0, (count, 2)), np.full((count, 1), 1.5), axis=1)
    sigma = np.tile([0.005, 0.005, 0.001, 0.01], (count, 1))
    offsets = rng.normal(size=(count, 4)) * sigma * [place, place, 1.0, turn]
    scales = laid_scales(pivots, offsets, sigma)
    together = common_columns(pivots) @ np.array([0.05, -0.02, 0.01, 0.03])
    np.testing.assert_allclose(laid_scales(pivots, offsets + together.reshape(-1, 4), sigma), scales, rtol=1e-6)
    for found, real in zip(scales[[0, 2, 3]], (place, 1.0, turn), strict=True):
        spread = 4.0 * math.sqrt(0.5 / (count - 1))
        believed = math.sqrt((4.0 + real**2 * (count - 1)) / (3.0 + count))  # the map's word is in it
        assert abs(math.log(found / believed)) < spread + 0.15
    assert (laid_scales(pivots[:1], offsets[:1], sigma[:1]) == 1.0).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 3.0), st.floats(0.6, 3.0), st.integers(30, 60))
def test_how_well_markers_were_printed_shows(seed: int, printed: float, corners: float, count: int) -> None:
    """By what the corners of a marker are off together, beyond what they scatter."""
    rng = np.random.default_rng(seed)
    residual = corners * rng.normal(size=(count, 4, 2)) + printed * rng.normal(size=(count, 1, 2))
    keep = np.ones(8 * count, dtype=bool)
    scale, share = scatter(residual.reshape(-1), keep, np.ones(count), 0)
    assert scale == pytest.approx(corners, rel=0.25)
    believed = (6.0 + 2 * count * printed**2) / (6.0 + 2 * count)  # the map's word is in it
    assert abs(share - believed) < 4.0 * (printed**2 + 0.25 * corners**2) / math.sqrt(count)
    assert scatter(residual[:2].reshape(-1), keep[:16], np.ones(2), 7)[1] == 1.0, "two markers tell nothing"


class Big:
    """The textbook filter on the 21 states and all sheets at once."""

    def __init__(self, x: FloatArray, p: FloatArray, sigma: FloatArray) -> None:
        self.x = np.append(x, np.zeros(sigma.size))
        self.p = np.zeros((len(self.x), len(self.x)))
        self.p[:NX, :NX] = p
        self.p[NX:, NX:] = np.diag(sigma.reshape(-1) ** 2)

    def predict(self, after: FilterState, f: FloatArray, q: FloatArray) -> None:
        whole = np.eye(len(self.x))
        whole[:NX, :NX] = f
        self.x[:NX] = after.x
        self.p = whole @ self.p @ whole.T
        self.p[:NX, :NX] += q

    def update(self, m: Measurement, moment: Moment, ground: SheetDependence | None, which: tuple[int, ...]) -> None:
        h = np.zeros((len(m.z), len(self.x)))
        h[:, :NX] = m.jacobian(self.x[:NX], moment, 0.0)
        y = m.residual(m.z, m.predicted(self.x[:NX], moment, 0.0))
        if ground is not None:
            columns = [NX + c for c in columns_of(which, ground.sheets)]
            h[:, columns] = ground.jacobian
            y = y - ground.jacobian @ (self.x[columns] - ground.at)
        s = h @ self.p @ h.T + m.noise
        gain = self.p @ h.T @ np.linalg.inv(s)
        if ground is None or not ground.learns:
            gain[NX:] = 0.0  # considered only (Schmidt)
        self.x = self.x + gain @ y
        rest = np.eye(len(self.x)) - gain @ h
        self.p = rest @ self.p @ rest.T + gain @ m.noise @ gain.T


def test_sheets_are_exact_kalman_states() -> None:
    """Steps, fixes, ties and headings in any order: as if the textbook's filter held all states in one vector."""
    rng = np.random.default_rng(3)
    sigma = np.array([[0.004, 0.003, 0.001, 0.01], [0.002, 0.002, 0.002, 0.005], [0.005, 0.005, 0.001, 0.02]])
    core = KalmanCore()
    state = core.start(rng.normal(0.0, 0.1, NX))
    big = Big(state.x, state.p, sigma[[0, 2, 1]])
    inertial = Inertial(0, 0.0, 0.0, 0.1, 0.1, (0.1, 0.0, 0.0), np.zeros(3), (0.0, 0.0), True)
    moment = Moment(inertial, (0.0, 0.0, 0.0, 0.0))
    step = InertialStep(0.02, 0.1, (0.1, 0.05, 0.0), ProcessNoiseMode.NOMINAL)
    which = (0, 2, 1)
    for n in range(40):
        f = np.eye(NX)
        before = state
        state = core.predict(state, step)
        for i in range(NX):
            d = np.zeros(NX)
            d[i] = 1e-6
            up = core.predict(before._replace(x=before.x + d), step).x
            down = core.predict(before._replace(x=before.x - d), step).x
            f[:, i] = (up - down) / 2e-6
        big.predict(state, f, state.p - f @ before.p @ f.T)
        sheets = ((0,), (0, 2), (2, 1))[n % 3] if n > 2 else (0, 2, 1)
        size = 4 * len(sheets)
        jac = rng.normal(size=(4, size))
        ground = SheetDependence(sheets, sigma[list(sheets)], jac, rng.normal(0.0, 1e-3, size), learns=n % 2 == 0)
        z = big.x[:4] + rng.normal(0.0, 1e-3, 4)
        fix = PoseFix(sensor="markers", t_us=0, z=z, noise=np.diag([1e-6, 2e-6, 1e-6, 1e-6]), ground=ground)
        rows = rng.normal(size=(3, size))
        tied = SheetDependence(sheets, sigma[list(sheets)], rows, np.zeros(size), learns=True)
        ties = SheetTies(sensor="sheets", t_us=0, z=rng.normal(0.0, 1e-2, 3), noise=np.eye(3) * 1e-3, ground=tied)
        for m, on in ((fix, ground), (heading_of(inertial), None), (ties, tied)):
            state = core.correct(state, core.innovation(state, m, moment, 0.0))
            assert state.sheets is None or state.sheets.which == which
            big.update(m, moment, on, which)
    assert state.sheets is not None
    np.testing.assert_allclose(state.x, big.x[:NX], atol=1e-8)
    np.testing.assert_allclose(state.sheets.offset, big.x[NX:], atol=1e-8)
    np.testing.assert_allclose(state.p, big.p[:NX, :NX], atol=1e-8)
    np.testing.assert_allclose(state.sheets.cross, big.p[:NX, NX:], atol=1e-8)
    np.testing.assert_allclose(state.sheets.cov, big.p[NX:, NX:], atol=1e-8)
