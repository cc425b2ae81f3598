"""The fit of a pose, the nearest markers and the filter's update in C against their Python: the same numbers."""

from typing import Any

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from test_markers_pose import CAMERA, sight

from autopilot.core import compiled
from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.markers import MarkerMap
from autopilot.estimator import markers_pose, pnp
from autopilot.estimator.compiled_fit import OnSheets, compiled_fit
from autopilot.estimator.kalman import MOST, CompiledUpdate
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.pnp import Pose, solve_pose
from autopilot.estimator.sheet_fit import SheetCorners, SheetPose, fit_on_sheets
from autopilot.estimator.states import NX
from tests.hostile_numbers import HOSTILE

pytestmark = pytest.mark.skipif(compiled.missing() is not None, reason="not compiled")
FLOOR_M = 1.5


class Picture:
    """Markers of drawn sizes on three sheets and beside them, seen with errors and some of them wrongly."""

    def __init__(self, seed: int, camera: CameraModel = CAMERA) -> None:
        rng = np.random.default_rng(seed)
        m = int(rng.integers(1, 30))
        self.pos = np.array([0.3, -0.2, FLOOR_M - rng.uniform(0.5, 1.3)])
        self.rpy = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(-3.0, 3.0)])
        centers = self.pos[:2] + rng.uniform(-0.25, 0.25, (m, 2))
        square = 0.05 * np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
        self.corners = np.full((m, 4, 3), FLOOR_M)
        self.corners[..., :2] = centers[:, None] + square
        rotation = r_ned_from_frd(self.rpy)
        pixels = camera.project(camera.cam_from_ned(self.corners, self.pos, rotation))
        self.pixels: FloatArray = pixels + rng.normal(0.0, 0.2, pixels.shape)
        if seed % 3 == 0:
            self.pixels[rng.integers(m), rng.integers(4)] += rng.uniform(-15.0, 15.0, 2)
        self.sigma_px = rng.uniform(0.1, 0.3, m) if seed % 2 else None
        self.sheet = rng.integers(-1, 3, m)
        self.pivot = np.column_stack((rng.uniform(-0.5, 0.5, (3, 2)), np.full(3, FLOOR_M)))
        self.print_m = rng.uniform(1e-4, 3e-4, m)
        a = rng.normal(size=(12, 12)) * 1e-3
        self.prior = rng.normal(size=12) * 2e-3, a @ a.T + 1e-7 * np.eye(12)
        self.start = self.pos + rng.normal(0.0, 0.02, 3), self.rpy + rng.normal(0.0, 0.01, 3)

    def alone(self) -> Pose | None:
        sigma = None if self.sigma_px is None else np.repeat(self.sigma_px, 4)
        corners, pixels = self.corners.reshape(-1, 3), self.pixels.reshape(-1, 2)
        return solve_pose(CAMERA, corners, pixels, *self.start, max_rms_px=20.0, sigma_px=sigma)

    def on_sheets(self) -> SheetPose | None:
        seen = SheetCorners(self.corners, self.pixels, self.sheet, self.pivot, self.print_m, self.sigma_px)
        return fit_on_sheets(CAMERA, seen, self.prior, *self.start, max_rms_px=20.0)


def by_python(monkeypatch: pytest.MonkeyPatch, fit: Any) -> Any:
    with monkeypatch.context() as patch:
        patch.setattr(pnp, "compiled_fit", lambda camera: None)
        return fit()


@pytest.mark.parametrize("seed", range(40))
def test_a_fit_is_the_same(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    picture = Picture(seed)
    for fit in (picture.alone, picture.on_sheets):
        ours, theirs = fit(), by_python(monkeypatch, fit)
        assert (ours is None) == (theirs is None)
        if ours is None or theirs is None:
            continue
        for name, mine, other in zip(ours._fields, ours, theirs, strict=True):
            if name == "jacobian":
                mine, other = mine(), other()
            if name == "alone":  # information and gradient
                mine, other = np.column_stack(mine), np.column_stack(other)
            scale = float(np.abs(other).max())
            if name in ("alone", "strain"):  # of a single sheet there is none
                scale = max(scale, 100.0)
            np.testing.assert_allclose(mine, other, rtol=1e-6, atol=1e-8 * scale, err_msg=name)


def test_most_of_the_pictures_are_fitted() -> None:
    pictures = [Picture(seed) for seed in range(40)]
    assert sum(picture.alone() is not None for picture in pictures) > 30
    assert sum(picture.on_sheets() is not None for picture in pictures) > 30


@pytest.mark.parametrize("value", HOSTILE)
def test_no_pose_is_made_of_what_is_no_number(value: float) -> None:
    for seed in range(20):
        for part in ("pixels", "corners", "start", "prior"):
            picture = Picture(seed)
            array = getattr(picture, part)
            array = array if isinstance(array, np.ndarray) else array[seed % 2 if part == "prior" else 0]
            array.flat[seed % array.size] = value
            with np.errstate(all="ignore"):
                for fit in (picture.alone, picture.on_sheets):
                    ours = fit()
                    noise = None if ours is None else ours.noise
                    assert noise is None or np.isfinite(noise).all()


def test_sheets_that_are_none_are_refused() -> None:
    picture, fit = Picture(1), compiled_fit(CAMERA)
    assert fit is not None
    m = len(picture.sheet)
    for sheet in (np.full(m, 3), np.full(m, -2), np.zeros(m + 1, dtype=int)):
        on = OnSheets(sheet, picture.pivot, picture.print_m, *picture.prior)
        pose = picture.pos, r_ned_from_frd(picture.rpy)
        with pytest.raises(ValueError, match="sheets"):
            fit.converged(picture.corners, picture.pixels.reshape(-1, 2), np.ones(8 * m), pose, 1.0, 0.2, on)


def test_the_nearest_markers_are_the_same(floor: MarkerMap, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, solver = np.random.default_rng(1), MarkerSolver(CAMERA, floor)
    for _ in range(30):
        pos, rpy = rng.uniform((-2.0, -1.0, 0.3), (2.0, 1.0, 0.95)), rng.uniform(-0.05, 0.05, 3)
        sighting = sight(floor, pos, rpy, rng)
        at = pos + rng.normal(0.0, 0.05, 3), rpy + rng.normal(0.0, 0.01, 3)
        ours = solver._match(sighting, *at)
        with monkeypatch.context() as patch:
            patch.setattr(markers_pose, "compiled_fit", lambda camera: None)
            theirs = solver._match(sighting, *at)
        assert ours is not None
        assert theirs is not None
        np.testing.assert_array_equal(ours.taken, theirs.taken)
        np.testing.assert_allclose(ours.shift_m, theirs.shift_m, atol=1e-12)
        np.testing.assert_allclose(ours.rays_cam, theirs.rays_cam, atol=1e-12)


@pytest.mark.parametrize("m", [1, 2, 4, 9, MOST])
def test_the_update_is_filterpys(m: int) -> None:
    """With noise that the state has a part in, as of sheets, filterpy's has that noise among its states."""
    rng, update = np.random.default_rng(m), CompiledUpdate.of_library()
    assert update is not None
    for turn in range(20):
        a = rng.normal(size=(NX + m, NX + m)) * 0.1
        whole = a @ a.T + 1e-4 * np.eye(NX + m)
        if turn % 2:
            whole[:NX, NX:] = whole[NX:, :NX] = whole[NX:, NX:] = 0.0
        x, y, h, b = rng.normal(size=NX), rng.normal(size=m), rng.normal(size=(m, NX)), rng.normal(size=(m, m))
        noise = b @ b.T + 1e-3 * np.eye(m)
        kf = ExtendedKalmanFilter(NX + m, m)
        kf.x, kf.P, wide = np.append(x, np.zeros(m)), whole, np.hstack((h, np.eye(m)))
        kf.update(y, lambda _, wide=wide: wide, lambda _: 0.0, R=noise)
        shared = whole[:NX, NX:]
        ours = update.update(x, whole[:NX, :NX], y, h, noise + whole[NX:, NX:] + (h @ shared).T, shared)
        theirs = kf.x[:NX], kf.P[:NX, :NX], kf.K[:NX], kf.S, kf.SI, kf.mahalanobis**2
        for name, mine, other in zip(ours._fields, ours, theirs, strict=True):
            np.testing.assert_allclose(mine, other, rtol=1e-8, atol=1e-10, err_msg=name)


@pytest.mark.parametrize("value", HOSTILE)
def test_an_update_of_no_numbers_gives_none(value: float) -> None:
    rng, update = np.random.default_rng(1), CompiledUpdate.of_library()
    assert update is not None
    for turn in range(30):
        given = [rng.normal(size=NX), np.eye(NX), rng.normal(size=3), rng.normal(size=(3, NX)), np.eye(3)]
        given[turn % 5].flat[turn % 3] = value
        with np.errstate(all="ignore"):
            try:
                ours = update.update(*given)
            except np.linalg.LinAlgError:
                continue
        if not np.isfinite(value):
            assert not all(np.isfinite(part).all() for part in ours), turn
