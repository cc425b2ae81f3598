"""Image quality of markers: contrast, noise and edge sharpness.

Measured at a few hundred interpolated pixels of each marker, all markers at once. The contrast-to-noise ratio
separates markers from false detections; all three give the accuracy of the corners.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from autopilot.core.dictionaries import opencv_dictionary
from autopilot.core.frames import FloatArray
from autopilot.core.markers import IntArray
from autopilot.estimator.estimator_tuning import MARKER_IMAGE


class MarkerImages(NamedTuple):
    """Each (n,), one value per marker."""

    contrast: FloatArray
    """White minus black cells [grey levels]; below 0 the cells are not those of the marker."""
    noise: FloatArray
    """Standard deviation of a pixel within cells of one colour [grey levels]."""
    fit: FloatArray
    """Correlation of the cells' grey levels with the marker's pattern, at most 1."""
    width_px: FloatArray
    """Of the outline: the distance over which its steepest slope would go from black to white."""


def marker_images(grey: Any, quads: FloatArray, patterns: FloatArray) -> MarkerImages:
    """Quality of markers with corners ``quads`` (n, 4, 2) [px] and cells ``patterns`` (n, s, s), 1 white, border
    included.
    """
    n, cells = patterns.shape[:2]
    to_px = _homographies(quads)
    steps = quads - np.roll(quads, -1, axis=1)
    sides_px = np.sqrt((steps * steps).sum(axis=2))
    off = min(MARKER_IMAGE.off_center / cells, MARKER_IMAGE.off_center_px / float(np.median(sides_px)))
    samples = _sample(grey, to_px, _around_centers(cells, off)).reshape(n, 4, cells, cells)
    level = samples.mean(axis=1)
    noise = np.sqrt(np.square(samples - level[:, None]).sum(axis=(1, 2, 3)) / (3.0 * cells * cells))
    bits = patterns - patterns.mean(axis=(1, 2), keepdims=True)
    power = np.square(bits).sum(axis=(1, 2))
    apart = level - level.mean(axis=(1, 2), keepdims=True)
    along = (apart * bits).sum(axis=(1, 2))
    spread = np.square(samples - level.mean(axis=(1, 2))[:, None, None, None]).mean(axis=1).sum(axis=(1, 2))
    fit = along / np.sqrt(np.maximum(power * spread, 1e-12))
    return MarkerImages(along / power, noise, fit, _widths_px(grey, to_px, sides_px.mean(axis=1), cells))


def cell_levels(grey: Any, quads: FloatArray, cells: int) -> FloatArray:
    """(n, s, s) grey levels of the cells of markers at ``quads`` (n, 4, 2) with so many along a side."""
    # Near the middle, where slanted cells are not blurred into each other.
    inside = _around_centers(cells, MARKER_IMAGE.misread_center / cells)
    sampled = _sample(grey, _homographies(quads), inside).reshape(len(quads), 4, cells, cells)
    return np.asarray(sampled.mean(axis=1), dtype=np.float64)


def misread_cells(grey: Any, quads: FloatArray, patterns: FloatArray) -> IntArray:
    """(n,) how many cells of markers at ``quads`` (n, 4, 2) are not as in ``patterns`` (n, s, s)."""
    level = cell_levels(grey, quads, patterns.shape[1])
    white = (level * patterns).sum(axis=(1, 2)) / np.maximum(patterns.sum(axis=(1, 2)), 1.0)
    black = (level * (1.0 - patterns)).sum(axis=(1, 2)) / np.maximum((1.0 - patterns).sum(axis=(1, 2)), 1.0)
    wrong = (level > 0.5 * (white + black)[:, None, None]) != (patterns > 0.5)
    return np.asarray(wrong.sum(axis=(1, 2)), dtype=np.int64)


def corner_sigma_px(images: MarkerImages, half_px: IntArray) -> FloatArray:
    """(n,) standard deviation along an axis of corners that were refined in windows of these half widths (n,).

    Noise moves an edge by its width times noise over contrast, and a corner is where two edges cross, each averaged
    over the window."""
    blurred = np.minimum(images.width_px, MARKER_IMAGE.widest_px) * images.noise / np.maximum(images.contrast, 1.0)
    sigma = MARKER_IMAGE.sigma_factor * blurred * np.sqrt((2.0 * MARKER_IMAGE.window_px + 1.0) / (2.0 * half_px + 1.0))
    return np.asarray(np.maximum(sigma, MARKER_IMAGE.min_sigma_px), dtype=np.float64)


def _homographies(quads: FloatArray) -> FloatArray:
    """(n, 3, 3) from the unit square (first corner at the origin, u to the second, v to the last) to pixels."""
    x, y = quads[..., 0].T, quads[..., 1].T
    sx, sy = x[0] - x[1] + x[2] - x[3], y[0] - y[1] + y[2] - y[3]
    dx1, dx2, dy1, dy2 = x[1] - x[2], x[3] - x[2], y[1] - y[2], y[3] - y[2]
    size = dx1 * dy2 - dx2 * dy1
    size = np.where(np.abs(size) < 1e-9, 1e-9, size)
    g, h = (sx * dy2 - dx2 * sy) / size, (dx1 * sy - sx * dy1) / size
    result = np.empty((len(quads), 3, 3))
    result[:, 0] = np.column_stack((x[1] - x[0] + g * x[1], x[3] - x[0] + h * x[3], x[0]))
    result[:, 1] = np.column_stack((y[1] - y[0] + g * y[1], y[3] - y[0] + h * y[3], y[0]))
    result[:, 2] = np.column_stack((g, h, np.ones(len(quads))))
    return result


def _around_centers(cells: int, off: float) -> FloatArray:
    """(2, 4 cells^2) points of the unit square: four about the centre of each cell, so far off along both axes."""
    center = (np.arange(cells) + 0.5) / cells
    low_high = np.array([center - off, center + off])
    shape = (2, 2, cells, cells)  # offset along u, offset along v, row, column
    u, v = low_high[:, None, None, :], low_high[None, :, :, None]
    return np.stack((np.broadcast_to(u, shape), np.broadcast_to(v, shape))).reshape(2, -1)


@lru_cache(maxsize=16)
def _across_edges(cells: int) -> FloatArray:
    """(2, k) points of the unit square: profiles across its four sides. Not to be changed."""
    along = (np.arange(MARKER_IMAGE.edge_places) + 1.5) / (MARKER_IMAGE.edge_places + 2)
    across = (
        np.linspace(-MARKER_IMAGE.edge_cells, MARKER_IMAGE.edge_cells, MARKER_IMAGE.edge_steps) / cells
    )  # from outside to inside
    a, b = np.meshgrid(along, across, indexing="ij")
    sides = np.stack([np.stack(s, axis=-1) for s in ((a, b), (1.0 - b, a), (a, 1.0 - b), (b, a))])
    return np.ascontiguousarray(sides.reshape(-1, 2).T)


def _sample(grey: Any, to_px: FloatArray, points: FloatArray) -> FloatArray:
    """Grey levels (n, k) at points (2, k) of n unit squares, between pixels by interpolation."""
    u, v = points
    # One axis at a time: a product of matrices with three columns costs several times as much.
    x, y, scale = (to_px[:, row, 0:1] * u + to_px[:, row, 1:2] * v + to_px[:, row, 2:3] for row in range(3))
    x /= scale
    y /= scale
    x_px, y_px = x.astype(np.float32), y.astype(np.float32)
    seen = cv2.remap(grey, x_px, y_px, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.float64)


def _widths_px(grey: Any, to_px: FloatArray, sides_px: FloatArray, cells: int) -> FloatArray:
    """(n,) widths of the outlines of markers whose sides are (n,) long."""
    levels = _sample(grey, to_px, _across_edges(cells)).reshape(len(to_px), -1, MARKER_IMAGE.edge_steps).mean(axis=1)
    steepest = np.maximum((levels[:, :-1] - levels[:, 1:]).max(axis=1), 1e-6)
    high = levels.max(axis=1) - levels.min(axis=1)
    step_px = sides_px / cells * (2.0 * MARKER_IMAGE.edge_cells / (MARKER_IMAGE.edge_steps - 1))
    return np.asarray(np.maximum(high / steepest * step_px, MARKER_IMAGE.min_width_px), dtype=np.float64)


@lru_cache(maxsize=16)
def patterns_of(dictionary: str) -> FloatArray:
    """(n, s, s) cells of all markers of a dictionary, 1 white, black border included. Not to be changed."""
    known = opencv_dictionary(dictionary)
    cells = int(known.markerSize)
    result = np.zeros((len(known.bytesList), cells + 2, cells + 2))
    for k, codeword in enumerate(known.bytesList):
        result[k, 1:-1, 1:-1] = cv2.aruco.Dictionary.getBitsFromByteList(codeword[None], cells)
    return result
