"""Markers that were found in an image, and where those are that were expected and not found."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.markers import IntArray
from autopilot.estimator.estimator_tuning import VISION


class Found(NamedTuple):
    """Markers of one image."""

    ids: IntArray
    """(n,)"""
    quads: Any
    """(n, 4, 2) corners [px]"""

    def with_new(self, more: "Found") -> "Found":
        """Both, without those of ``more`` that are here already."""
        if not len(self.ids) or not len(more.ids):
            return more if len(more.ids) else self
        new = ~(self._near(more.quads) & (more.ids[:, None] == self.ids[None, :])).any(axis=1)
        return Found(np.append(self.ids, more.ids[new]), np.concatenate((self.quads, more.quads[new])))

    def since(self, first: int) -> "Found":
        """Those from the one of that number on."""
        return Found(self.ids[first:], self.quads[first:])

    def elsewhere(self, quads: Any) -> Any:
        """Those quadrilaterals (m, 4, 2), largest first, that are not where a marker was found."""
        quads = quads[np.argsort(-perimeters_px(quads), kind="stable")]
        return quads[~self._near(quads).any(axis=1)]

    def _near(self, quads: Any) -> Any:
        """(m, n) whether quadrilaterals (m, 4, 2) are where the markers are."""
        apart = quads.mean(axis=1)[:, None, :] - self.quads.mean(axis=1)[None, :, :]
        return (apart * apart).sum(axis=2) < np.square(VISION.same * perimeters_px(quads) / 4.0)[:, None]


class Missing(NamedTuple):
    """Expected markers that were not found."""

    ids: IntArray
    """(n,)"""
    places: FloatArray
    """(n, 4, 2) where they should be [px],"""
    spread_px: float
    """and the error of that."""


def nearest_of(ids: IntArray, predicted: FloatArray, found: Found) -> IntArray:
    """(n,) for each found marker the nearest one of its id of those predicted (m,)."""
    apart = found.quads.mean(axis=1)[:, None, :] - predicted.mean(axis=1)[None, :, :]
    far = np.where(found.ids[:, None] == ids[None, :], (apart * apart).sum(axis=2), np.inf)
    return np.asarray(far.argmin(axis=1), dtype=np.int64)


def missing_markers(ids: IntArray, predicted: FloatArray, found: Found, shape: tuple[int, ...]) -> Missing:
    """The markers that were found give the error of the prediction."""
    if not len(found.ids):
        return Missing(ids, predicted, VISION.hint_margin_px)
    nearest = nearest_of(ids, predicted, found)
    here, spread_px = _moved(predicted, nearest, found.quads)
    missing = np.ones(len(ids), dtype=bool)
    missing[nearest] = False
    missing &= inside(here, shape, VISION.whole_px)
    return Missing(ids[missing], here[missing], spread_px)


def areas_of(left: Missing, found: Found, shape: tuple[int, ...]) -> list[tuple[int, int, int, int]]:
    """Left, top, right, bottom of the image regions with missing markers; where none was found, of the image."""
    height, width = shape
    if not len(found.ids):
        return [(0, 0, width, height)]
    low, high = left.places.min(axis=1), left.places.max(axis=1)
    around = np.maximum(VISION.around * (high - low).max(axis=1, keepdims=True), VISION.around_px) + left.spread_px
    low = np.maximum(np.floor(low - around), 0.0).astype(int)
    high = np.minimum(np.ceil(high + around) + 1.0, [width, height]).astype(int)
    if len(low) > VISION.most_areas or (high - low).prod(axis=1).sum() > (high.max(axis=0) - low.min(axis=0)).prod():
        low, high = low.min(axis=0)[None], high.max(axis=0)[None]
    return [(x, y, right, bottom) for (x, y), (right, bottom) in zip(low.tolist(), high.tolist(), strict=True)]


def inside(quads: Any, shape: tuple[int, ...], border_px: float) -> NDArray[np.bool_]:
    """(n,) which quadrilaterals (n, 4, 2) are that far inside of an image."""
    last_px = np.array(shape[::-1]) - 1.0 - border_px
    return np.asarray(((quads >= border_px) & (quads <= last_px)).all(axis=(1, 2)))


def perimeters_px(quads: Any) -> FloatArray:
    """(n,) of quadrilaterals (n, 4, 2)."""
    steps = quads - np.roll(quads, -1, axis=1)
    return np.asarray(np.sqrt((steps * steps).sum(axis=2)).sum(axis=1), dtype=np.float64)


def _moved(predicted: FloatArray, which: IntArray, quads: Any) -> tuple[FloatArray, float]:
    """Predicted corners (n, 4, 2), shifted, turned and scaled to where those of ``which`` (m,) were found, and how far
    most of these are then off [px]."""
    have = (predicted[..., 0] + 1j * predicted[..., 1])[which]
    want = (quads[..., 0] + 1j * quads[..., 1]).astype(np.complex128)
    good = np.ones(len(have), dtype=bool)
    for _ in range(2):  # the second time without outliers
        origin, target = have[good].mean(), want[good].mean()
        power = np.square(np.abs(have[good] - origin)).sum()
        turn = (np.conj(have[good] - origin) * (want[good] - target)).sum() / power
        off = np.abs(want - target - turn * (have - origin)).max(axis=1)
        usual = float(np.median(off))
        good = off <= 3.0 * usual + 1.0
    all_of_them = target + turn * (predicted[..., 0] + 1j * predicted[..., 1] - origin)
    return np.stack((all_of_them.real, all_of_them.imag), axis=-1), 3.0 * usual
