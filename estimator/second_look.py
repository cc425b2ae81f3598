"""A second look at quadrilaterals that were nearly markers.

The first look takes corners in whole pixels and one threshold for all cells, which misreads markers with cells of two
pixels and those that something touches. Here straight lines are fitted to the four sides, cells are read between the
pixels and compared with every word that the place allows, each with its own levels of black and white.

As many misread cells are corrected as keeps a word of noise from being read: the fewer words a place allows, the more.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.markers import IntArray
from autopilot.estimator.estimator_tuning import SECOND_LOOK, VISION
from autopilot.estimator.marker_image import cell_levels

BoolArray = np.ndarray[Any, np.dtype[np.bool_]]


class SecondLook(NamedTuple):
    which: IntArray
    """(m,) places of the markers read among the patterns."""
    quads: FloatArray
    """(m, 4, 2) corners, the marker's first one first [px]."""


def read_again(grey: Any, quads: FloatArray, patterns: FloatArray, allowed: BoolArray, correct: int) -> SecondLook:
    """Markers among ``quads`` (n, 4, 2), clockwise, with cells ``patterns`` (k, s, s) as in :func:`marker_images`.

    ``allowed`` (n, 4, k): whether a quadrilateral whose first corner is the marker's first, second, ... may be that
    marker. ``correct``: misread cells that are corrected at most.
    """
    cells = patterns.shape[1]
    words = allowed.sum(axis=(1, 2))
    most = np.array([correctable((cells - 2) ** 2, count, correct) for count in words.tolist()], dtype=np.int64)
    if not (most >= 0).any():
        return SecondLook(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)))
    quads, rise = along_sides(grey, quads[most >= 0], cells)
    allowed, most = allowed[most >= 0], most[most >= 0]
    level = cell_levels(grey, quads, cells).reshape(len(quads), -1)
    # (4 k, s * s): a quadrilateral that begins with the marker's second corner shows it turned by a quarter.
    turned = np.stack([np.rot90(patterns, turn, axes=(1, 2)) for turn in range(4)]).reshape(-1, cells * cells)
    fits = np.where(allowed.reshape(len(quads), -1), _unit(level) @ _unit(turned).T, -1.0)
    best = fits.argmax(axis=1)
    fit, word = fits[np.arange(len(quads)), best], turned[best]
    white = (level * word).sum(axis=1) / word.sum(axis=1)
    black = (level * (1.0 - word)).sum(axis=1) / (1.0 - word).sum(axis=1)
    wrong = ((level > 0.5 * (white + black)[:, None]) != (word > 0.5)).sum(axis=1)
    last_px = np.array(grey.shape[::-1]) - 1.0 - VISION.border_px
    inside = ((quads >= VISION.border_px) & (quads <= last_px)).all(axis=(1, 2))
    # A marker that the image cuts off shows its cells and not all of its sides.
    whole = inside & (rise >= SECOND_LOOK.least_rise * (white - black)[:, None]).all(axis=1)
    read = np.flatnonzero(whole & (fit >= SECOND_LOOK.least_fit) & (wrong <= most))
    read = _apart(read[np.argsort(-fit[read], kind="stable")], quads)
    turn, which = np.divmod(best[read], len(patterns))
    corners = (np.arange(4)[None, :] - turn[:, None]) % 4
    return SecondLook(which, quads[read[:, None], corners])


def near_predicted(quads: FloatArray, predicted: FloatArray, reach_px: float) -> tuple[FloatArray, BoolArray]:
    """The first of ``quads`` (n, 4, 2) that lie near markers (k, 4, 2), and which may be which: (m, 4, k) as
    :func:`read_again` takes it."""
    sides = predicted - np.roll(predicted, -1, axis=1)
    reach_px = SECOND_LOOK.reach * np.sqrt((sides * sides).sum(axis=2)).mean(axis=1) + reach_px
    # The middles first: noise makes thousands of quadrilaterals.
    near = _far(quads.mean(axis=1)[:, None], predicted.mean(axis=1)) <= reach_px
    quads = quads[near.any(axis=1)][: SECOND_LOOK.most]
    starts = (np.arange(4)[None, :] - np.arange(4)[:, None]) % 4
    far = _far(quads[:, starts, None], predicted.transpose(1, 0, 2)).max(axis=2)
    return quads, np.asarray(far <= reach_px, dtype=np.bool_)


def _far(some: FloatArray, others: FloatArray) -> FloatArray:
    """Distances of points, (..., 2) both."""
    apart = some - others
    return np.asarray(np.sqrt((apart * apart).sum(axis=-1)))


@lru_cache(maxsize=256)
def correctable(bits: int, words: int, correct: int) -> int:
    """Misread cells, at most ``correct``, with which noise of so many bits is one of so many words rarely enough.

    -1 if there is no word, or noise would be one too often even without any."""
    taken = -1
    if words == 0:
        return taken
    chance = 0.0
    for wrong in range(correct + 1):
        chance += words * math.comb(bits, wrong) / 2.0**bits
        if chance <= SECOND_LOOK.chance:
            taken = wrong
    return taken


def along_sides(grey: Any, quads: FloatArray, cells: int) -> tuple[FloatArray, FloatArray]:
    """Corners (n, 4, 2), clockwise, moved to where lines along the steepest slopes from black to white cross, and how
    much brighter it is outside of each side (n, 4)."""
    along = (np.arange(SECOND_LOOK.places) + 1.0) / (SECOND_LOOK.places + 1.0) - 0.5
    across = np.linspace(-1.0, 1.0, SECOND_LOOK.steps)
    corners = np.asarray(quads, dtype=np.float64)
    side = np.roll(corners, -1, axis=1) - corners
    long_px = np.maximum(np.sqrt((side * side).sum(axis=2)), 1.0)
    outward = np.stack((side[..., 1], -side[..., 0]), axis=-1) / long_px[..., None]
    reach_px = np.clip(SECOND_LOOK.across_cells * long_px / cells, *SECOND_LOOK.across_px)
    middle = corners + 0.5 * side
    x, y = (
        middle[..., axis, None, None]
        + side[..., axis, None, None] * along[:, None]
        + (outward[..., axis] * reach_px)[..., None, None] * across
        for axis in range(2)
    )
    shape = (len(corners), -1)
    seen = cv2.remap(
        grey,
        x.astype(np.float32).reshape(shape),
        y.astype(np.float32).reshape(shape),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    level = np.asarray(seen, dtype=np.float64).reshape(x.shape)
    slope = np.maximum(np.diff(level, axis=-1), 0.0)
    weight = np.square(slope)
    total = weight.sum(axis=-1) + 1e-6
    off = (weight * (across[1:] + across[:-1]) * 0.5).sum(axis=-1) / total * reach_px[..., None]
    # Least squares of off = shift + tilt * along, each place with its own weight.
    sums = [(total * along**power).sum(axis=-1) for power in range(3)]
    first, second = (total * off).sum(axis=-1), (total * along * off).sum(axis=-1)
    tilt = (sums[0] * second - sums[1] * first) / np.maximum(sums[0] * sums[2] - sums[1] ** 2, 1e-9)
    shift = (first - sums[1] * tilt) / sums[0]
    moved = _crossings(middle + outward * shift[..., None], side + outward * tilt[..., None])
    jump = np.abs(moved - corners).max(axis=(1, 2)) <= 2.0 * reach_px.max(axis=1)
    corners = np.where(jump[:, None, None], moved, corners)
    return corners, (level[..., -1] - level[..., 0]).mean(axis=2)


def _crossings(points: FloatArray, along: FloatArray) -> FloatArray:
    """(n, 4, 2) where each of four lines (a point and a direction) meets the one before."""
    before, its = np.roll(points, 1, axis=1), np.roll(along, 1, axis=1)
    cross = its[..., 0] * along[..., 1] - its[..., 1] * along[..., 0]
    gap = points - before
    step = (gap[..., 0] * along[..., 1] - gap[..., 1] * along[..., 0]) / np.where(np.abs(cross) < 1e-6, 1e-6, cross)
    return np.asarray(before + its * step[..., None], dtype=np.float64)


def _unit(rows: FloatArray) -> FloatArray:
    """Rows without their mean, of length 1."""
    apart = rows - rows.mean(axis=1, keepdims=True)
    return np.asarray(apart / np.maximum(np.sqrt((apart * apart).sum(axis=1, keepdims=True)), 1e-9))


def _apart(order: IntArray, quads: FloatArray) -> IntArray:
    """Those of ``order`` that do not lie where an earlier one does."""
    middles = quads.mean(axis=1)
    near_px = SECOND_LOOK.same * np.abs(quads - middles[:, None]).max(axis=(1, 2))
    kept: list[int] = []
    for one in order.tolist():
        if all(np.abs(middles[one] - middles[other]).max() > near_px[one] for other in kept):
            kept.append(one)
    return np.array(kept, dtype=np.int64)
