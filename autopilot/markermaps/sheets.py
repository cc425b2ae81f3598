"""A level marker map as sheets to print in true size, cut along the crop marks and laid edge to edge.

The plane of a sheet is the map turned by a heading: up on the paper is that heading. Pages stand on a lattice; a marker
is printed whole on the page in whose cell its upper left corner lies. Where markers form a grid the cells are whole
numbers of its pitch, and sheets meet in the middle of the gaps.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from autopilot.core.dictionaries import black_runs, opencv_dictionary
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.map_errors import Laid, map_errors
from autopilot.core.markers import ID_SPAN, IntArray, MarkerMap
from autopilot.markermaps.markermaps_tuning import SHEETS
from autopilot.markermaps.page import PrintedPage, PrintedText

PAPERS_MM = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}
"""Portrait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Paper:
    width_mm: float
    height_mm: float
    margin_mm: float = 8.0
    """That the printer leaves white."""

    @property
    def window_m(self) -> tuple[float, float]:
        """Width and height that markers can use."""
        frame = 2.0 * (self.margin_mm + SHEETS.mark_mm)
        return (self.width_mm - frame) / 1e3, (self.height_mm - frame - SHEETS.footer_mm) / 1e3


def paper_of(name: str, landscape: bool, margin_mm: float) -> Paper:
    """Paper by name, or by ``WIDTHxHEIGHT`` in millimetres. ConfigError if it is neither."""
    size = PAPERS_MM.get(name.upper())
    if size is None:
        try:
            width, height = (float(part) for part in name.lower().split("x"))
        except ValueError as error:
            raise ConfigError(
                f"paper {name!r} is not known; use {', '.join(PAPERS_MM)} or WIDTHxHEIGHT in millimetres, e.g. 600x900"
            ) from error
        size = (width, height)
    if landscape:
        size = (size[1], size[0])
    paper = Paper(width_mm=size[0], height_mm=size[1], margin_mm=margin_mm)
    if not (math.isfinite(sum(size)) and min(paper.window_m) > 0.0):
        raise ConfigError(f"paper {name!r} with a margin of {margin_mm:g} mm leaves no room; use a larger one")
    return paper


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plane:
    """The markers on the plane of the sheets: x to the right, y downwards [m], up = ``heading_rad``."""

    markers: MarkerMap
    heading_rad: float
    corners_m: FloatArray
    """(n, 4, 2)"""
    pitch_m: float | None
    """Of the grid that the markers form, None if they form none."""

    @property
    def low_m(self) -> FloatArray:
        """(n, 2) upper left corners of the markers' bounding boxes."""
        return np.asarray(self.corners_m.min(axis=1))

    @property
    def high_m(self) -> FloatArray:
        """(n, 2) lower right corners."""
        return np.asarray(self.corners_m.max(axis=1))

    def ned_m(self, place_m: FloatArray) -> FloatArray:
        """North and east of a point (2,) on the plane."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return np.array([-c * place_m[1] - s * place_m[0], -s * place_m[1] + c * place_m[0]])


def plane_of(markers: MarkerMap, heading_rad: float, pitch_m: float | None) -> Plane:
    """The plane of a level map. ConfigError if it is not level."""
    if not markers.level:
        raise ConfigError("markers that do not lie face up on one level cannot be printed together; print level boards")
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    north, east = markers.corners_ned_m[..., 0], markers.corners_ned_m[..., 1]
    corners = np.stack((c * east - s * north, -(c * north + s * east)), axis=-1)
    return Plane(markers=markers, heading_rad=heading_rad, corners_m=corners, pitch_m=pitch_m)


def make_sheets(plane: Plane, paper: Paper, title: str) -> list[PrintedPage]:
    """All pages, row by row. ConfigError if a marker does not fit on the paper."""
    cut = _cut(plane, paper)
    pages = []
    for number, (row, column) in enumerate(cut.used.tolist(), start=1):
        inside = np.flatnonzero(cut.page == number)
        origin = cut.start_m + cut.cell_m * np.array([column, row])
        name = f"{title}: sheet {number} of {len(cut.used)} (row {row + 1}, column {column + 1})"
        pages.append(_page(plane, paper, inside, origin, cut.size_m, name))
    return pages


def on_sheets(plane: Plane, paper: Paper) -> MarkerMap:
    """The map with the marker's sheet number of :func:`make_sheets` as its sheet. Uncertainties of previous sheets
    are dropped. ConfigError as there.
    """
    page = _cut(plane, paper).page
    markers = plane.markers
    heading = np.full(len(page), plane.heading_rad)
    laid = [Laid(sheet=f"{number}") for number in page.tolist()]
    return replace(markers, errors=map_errors(markers.centers_ned_m, heading, laid))


class _Cut(NamedTuple):
    """How the plane is cut into pages."""

    start_m: FloatArray
    cell_m: FloatArray
    size_m: FloatArray
    """(2,) upper left corner of the first page, from page to page, and of what is cut out."""
    used: IntArray
    """(k, 2) row and column of the pages, in their order."""
    page: IntArray
    """(n,) number of each marker's page, from 1."""


def _cut(plane: Plane, paper: Paper) -> _Cut:
    low, high = plane.low_m, plane.high_m
    largest = (high - low).max(axis=0)
    window = np.array(paper.window_m)
    if (largest > window).any():
        raise ConfigError(
            f"a marker takes {1e3 * largest[0]:.0f} x {1e3 * largest[1]:.0f} mm and the paper has room for"
            f" {1e3 * window[0]:.0f} x {1e3 * window[1]:.0f} mm; use larger paper"
        )
    if plane.pitch_m is None:
        start, cell = low.min(axis=0), window - largest + 1e-9
        size = window
    else:
        gap_m = max(plane.pitch_m - float(plane.markers.size_m), 0.0)
        start = low.min(axis=0) - 0.5 * gap_m
        cell = plane.pitch_m * np.maximum(np.floor(window / plane.pitch_m + 1e-9), 1.0)
        size = np.minimum(cell, window)
    where = np.floor((low - start) / cell + 1e-9).astype(np.int64)
    used, page = np.unique(where[:, ::-1], axis=0, return_inverse=True)
    if len(used) > SHEETS.max_pages:
        raise ConfigError(
            f"{len(used)} sheets would be needed and at most {SHEETS.max_pages} are made; use larger paper"
        )
    return _Cut(start, cell, size, used, np.asarray(page, dtype=np.int64).reshape(-1) + 1)


def _page(
    plane: Plane, paper: Paper, inside: IntArray, origin_m: FloatArray, size_m: FloatArray, name: str
) -> PrintedPage:
    """One sheet with the markers ``inside``; ``origin_m`` (2,): upper left corner of the trimmed area."""
    page = PrintedPage(width_mm=paper.width_mm, height_mm=paper.height_mm)
    frame = np.full(2, paper.margin_mm + SHEETS.mark_mm)
    markers = plane.markers
    for n in inside:
        corners_mm = 1e3 * (plane.corners_m[n] - origin_m) + frame
        kind, marker_id = divmod(int(markers.ids[n]), ID_SPAN)
        page.shapes.append(_marker_shape(markers.dictionaries[kind], marker_id, corners_mm))
        gap_mm = (
            SHEETS.label_mm / SHEETS.label_fraction
            if plane.pitch_m is None
            else 1e3 * (plane.pitch_m - float(markers.sizes_m[n]))
        )
        height_mm = min(SHEETS.label_mm, SHEETS.label_fraction * gap_mm)
        if height_mm >= SHEETS.min_label_mm:
            north, east, _ = markers.centers_ned_m[n]
            baseline = float(corners_mm[:, 1].max()) + SHEETS.label_place * gap_mm
            label = f"{marker_id}  N {north:+.3f}  E {east:+.3f} m"
            page.texts.append(
                PrintedText(x_mm=float(corners_mm[:, 0].min()), y_mm=baseline, height_mm=height_mm, text=label)
            )
    _add_crop_marks(page, frame, frame + 1e3 * size_m)
    _add_footer(page, paper, plane, origin_m, name)
    return page


def _marker_shape(dictionary: str, marker_id: int, corners_mm: FloatArray) -> list[FloatArray]:
    """The black cells of a marker with these corners (4, 2), joined along rows."""
    patterns = opencv_dictionary(dictionary)
    cells = patterns.markerSize + 2
    across, down = (corners_mm[1] - corners_mm[0]) / cells, (corners_mm[3] - corners_mm[0]) / cells
    shape = []
    for row, first, last in black_runs(patterns, marker_id):
        left, right = corners_mm[0] + first * across, corners_mm[0] + last * across
        shape.append(np.array([left, right, right + down, left + down]) + row * down)
    return shape


def _add_crop_marks(page: PrintedPage, low_mm: FloatArray, high_mm: FloatArray) -> None:
    """Two short lines outside of each corner of the trimmed area."""
    gap = 0.5
    for x, away in ((float(low_mm[0]), -1.0), (float(high_mm[0]), 1.0)):
        for y in (float(low_mm[1]), float(high_mm[1])):
            page.lines.append((x + away * gap, y, x + away * SHEETS.mark_mm, y))
    for y, away in ((float(low_mm[1]), -1.0), (float(high_mm[1]), 1.0)):
        for x in (float(low_mm[0]), float(high_mm[0])):
            page.lines.append((x, y + away * gap, x, y + away * SHEETS.mark_mm))


def _add_footer(page: PrintedPage, paper: Paper, plane: Plane, origin_m: FloatArray, name: str) -> None:
    """Scale bar, name of the sheet, and its position."""
    x, y = paper.margin_mm, paper.height_mm - paper.margin_mm - 0.5 * SHEETS.footer_mm
    length = min(SHEETS.bar_mm, 10.0 * math.floor((paper.width_mm - 2.0 * paper.margin_mm) / 10.0))
    page.lines.append((x, y, x + length, y))
    for tick in range(round(length / 10.0) + 1):
        tall = 2.0 if tick in (0, round(length / 10.0)) else 1.0
        page.lines.append((x + 10.0 * tick, y, x + 10.0 * tick, y - tall))
    north, east = plane.ned_m(origin_m)
    heading = math.degrees(plane.heading_rad) % 360.0
    page.texts.extend(
        [
            PrintedText(x_mm=x + length + 2.0, y_mm=y, height_mm=2.2, text=f"{length:g} mm; print at 100 %"),
            PrintedText(
                x_mm=x,
                y_mm=y + 3.2,
                height_mm=2.2,
                text=f"{name}; upper left crop mark N {north:+.4f} E {east:+.4f} m, top to {heading:.1f} deg",
            ),
        ]
    )
