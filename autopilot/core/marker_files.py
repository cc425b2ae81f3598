"""The marker map file in TOML: dictionary, id, size and pose of every marker (docs/markers.md).

``[[marker]]`` defines one marker, ``[[board]]`` a grid of them; both may be mixed, and so may dictionaries and sizes.
A pose is that of the marker's frame: x to its top, y to its right, z into the surface it is printed on. With all
angles zero it lies face up with its top to the north.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from autopilot.core.dictionaries import dictionary_label, dictionary_size, resolve_dictionary
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, r_ned_from_frd, rpy_from_r
from autopilot.core.map_errors import DEPTH_SIGMA_M, PRINT_SIGMA_M, SCALE_SIGMA, SHEET_SIGMA_M, Laid, map_errors
from autopilot.core.markers import CORNER_SIGNS, ID_SPAN, MarkerMap
from autopilot.core.toml_table import Angle, Angles3, NonNegative, Sigma, Table, Vec3, convert, read_toml

AMBIGUITY_M = 0.9
"""Markers of one id must lie this far apart: the estimator takes the nearest within half of it."""
MAX_SIZE_M = 5.0
MAX_MARKERS = 20_000
FLAT_M = 0.01
"""Markers whose planes are this close and that cover each other overlap; farther apart one hangs above the other."""
MAX_DICTIONARIES = 16
"""In one map; ids go into the log as 16 bit numbers."""
OVERLAP_SIGMAS = 4.0
"""Markers of two sheets may overlap in the map by so many times what the sheets may be off."""
NOTHING_SAID = Laid()

Index = Annotated[int, msgspec.Meta(ge=0)]
Count = Annotated[int, msgspec.Meta(ge=1, le=1000)]
Size = Annotated[float, msgspec.Meta(gt=0.0, le=MAX_SIZE_M)]


class Defaults(Table, frozen=True, kw_only=True):
    """``[defaults]``: values for markers and boards without their own."""

    dictionary: str | None = None
    size_m: Size | None = None
    sigma_m: Sigma | None = None
    """How well sheets (and single markers) were laid: standard deviation of their place per axis,"""
    sigma_rad: Sigma | None = None
    """and of their heading."""
    print_sigma_m: Sigma = PRINT_SIGMA_M
    """Standard deviation of a marker's position on its sheet."""
    scale_sigma: Sigma = SCALE_SIGMA
    """The same of the printed size, as a share of it: heights are off by that share. Measure the sheet's scale bar."""


class MapFrame(Table, frozen=True, kw_only=True):
    """``[frame]``: standard deviations of the whole map against the frame that it was laid in."""

    sigma_m: NonNegative = 0.0
    """Horizontally, per axis."""
    sigma_down_m: NonNegative = DEPTH_SIGMA_M
    sigma_rad: Sigma = 0.0


class MapEntry(Table, frozen=True, kw_only=True):
    """Common keys of ``[[marker]]`` and ``[[board]]``."""

    center_m: Vec3
    """North, east, down of its middle."""
    yaw_rad: Angle | None = None
    """Where its top points, clockwise from north, when it lies face up."""
    rpy_rad: Angles3 | None = None
    """Instead: roll, pitch, yaw of its frame."""
    dictionary: str | None = None
    size_m: Size | None = None
    """Side of the black square of a marker."""
    sheet: str | None = None
    """Name of the sheet it was printed on; without it a board is a sheet of its own, and sheets of single markers are
    found by their lattice."""
    sigma_m: Sigma | None = None
    """How well that was laid, 0 = exactly."""
    sigma_rad: Sigma | None = None

    def __post_init__(self) -> None:
        if self.yaw_rad is not None and self.rpy_rad is not None:
            raise ValueError("give either `yaw_rad` or `rpy_rad`")

    @property
    def r_ned_from_marker(self) -> FloatArray:
        """(3, 3)"""
        return r_ned_from_frd(np.array(self.rpy_rad or (0.0, 0.0, self.yaw_rad or 0.0)))

    def laid(self, sheet: str | None, defaults: Defaults) -> Laid:
        """Its laying accuracy, on that sheet."""
        return Laid(
            sheet=sheet,
            sigma_m=self.sigma_m if self.sigma_m is not None else defaults.sigma_m,
            sigma_rad=self.sigma_rad if self.sigma_rad is not None else defaults.sigma_rad,
        )


class MarkerEntry(MapEntry, frozen=True, kw_only=True):
    """``[[marker]]``"""

    id: Index


class BoardEntry(MapEntry, frozen=True, kw_only=True):
    """``[[board]]``: a grid; its first marker is at the top left, the following ones to the right, row by row."""

    rows: Count
    columns: Count
    gap_m: NonNegative
    """Between the black squares."""
    first_id: Index | None = None
    """Ids count up from it."""
    ids: list[Index] | None = None
    """Instead: one id per marker."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.first_id is None) == (self.ids is None):
            raise ValueError("give either `first_id` or `ids`")
        if self.ids is not None and len(self.ids) != self.rows * self.columns:
            raise ValueError(f"`ids` has {len(self.ids)} entries; {self.rows} x {self.columns} markers need one each")


class MarkerFile(Table, frozen=True, kw_only=True):
    name: str = ""
    defaults: Defaults = Defaults()
    frame: MapFrame = MapFrame()
    marker: list[MarkerEntry] = msgspec.field(default_factory=list)
    board: list[BoardEntry] = msgspec.field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlacedMarker:
    """One marker of a map by its plain values."""

    place: str
    """Where it stands in the file, e.g. ``$.board[1]``."""
    dictionary: str
    id: int
    size_m: float
    center_ned_m: FloatArray
    r_ned_from_marker: FloatArray
    """(3, 3)"""
    laid: Laid = NOTHING_SAID
    """How well."""

    @property
    def label(self) -> str:
        return f"{self.place} (id {self.id} of {dictionary_label(self.dictionary)})" if self.place else f"id {self.id}"

    @property
    def corners_ned_m(self) -> FloatArray:
        """(4, 3)"""
        flat = np.column_stack((0.5 * self.size_m * CORNER_SIGNS, np.zeros(4)))
        return self.center_ned_m + flat @ self.r_ned_from_marker.T


def load_marker_map(path: Path) -> MarkerMap:
    """The map of a file. ConfigError names marker, value and remedy."""
    file: MarkerFile = convert(read_toml(path), MarkerFile, str(path))
    frame = (file.frame.sigma_m, 0.0, file.frame.sigma_rad)
    placed = _placed(file, path.parent, str(path))
    print_sigma_m = file.defaults.print_sigma_m
    result = make_map(placed, str(path), frame_sigma=frame, print_sigma_m=print_sigma_m, loose_sigma_m=SHEET_SIGMA_M)
    return replace(result, depth_sigma_m=file.frame.sigma_down_m, scale_sigma=file.defaults.scale_sigma)


def make_map(
    placed: Sequence[PlacedMarker],
    origin: str,
    *,
    frame_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
    print_sigma_m: float = PRINT_SIGMA_M,
    loose_sigma_m: float = 0.0,
) -> MarkerMap:
    """The validated map of these markers with its error model. ConfigError begins with ``origin``.

    ``loose_sigma_m``: standard deviation of markers on no sheet without a stated one.
    """
    if not 1 <= len(placed) <= MAX_MARKERS:
        raise ConfigError(f"{origin}: holds {len(placed)} markers; give 1 to {MAX_MARKERS} [[marker]] or [[board]]")
    whole = _whole_dictionaries({marker.dictionary for marker in placed})
    numbers: dict[str, int] = {}
    for marker in placed:
        numbers.setdefault(whole[marker.dictionary], len(numbers))
    if len(numbers) > MAX_DICTIONARIES:
        raise ConfigError(f"{origin}: uses {len(numbers)} dictionaries; use at most {MAX_DICTIONARIES}")
    names = tuple(numbers)
    sizes = [marker.size_m for marker in placed]
    result = MarkerMap(
        dictionary=names[0],
        size_m=sorted(sizes)[len(sizes) // 2],
        ids=np.array([ID_SPAN * numbers[whole[m.dictionary]] + m.id for m in placed], dtype=np.int64),
        corners_ned_m=np.array([marker.corners_ned_m for marker in placed]),
        more_dictionaries=names[1:],
        errors=map_errors(
            np.array([m.center_ned_m for m in placed]),
            np.array([rpy_from_r(m.r_ned_from_marker)[2] for m in placed]),
            [m.laid for m in placed],
            frame_sigma=frame_sigma,
            print_sigma_m=print_sigma_m,
            loose_sigma_m=loose_sigma_m,
        ),
    )
    _refuse_duplicates(result, placed, origin)
    _refuse_overlaps(result, placed, origin)
    return result


def _placed(file: MarkerFile, folder: Path, origin: str) -> list[PlacedMarker]:
    """All markers of a file one by one. ConfigError for an invalid marker."""
    result: list[PlacedMarker] = []
    for index, entry in enumerate(file.marker):
        place = f"$.marker[{index}]"
        dictionary, size_m = _kind(entry, file.defaults, place, folder, origin)
        _check_id(entry.id, dictionary, place, origin)
        result.append(
            PlacedMarker(
                place=place,
                dictionary=dictionary,
                id=entry.id,
                size_m=size_m,
                center_ned_m=np.array(entry.center_m),
                r_ned_from_marker=entry.r_ned_from_marker,
                laid=entry.laid(entry.sheet, file.defaults),
            )
        )
    for index, board in enumerate(file.board):
        place = f"$.board[{index}]"
        dictionary, size_m = _kind(board, file.defaults, place, folder, origin)
        if len(result) + board.rows * board.columns > MAX_MARKERS:
            raise ConfigError(f"{origin}: `{place}` brings the map to more than {MAX_MARKERS} markers; use fewer")
        start = 0 if board.first_id is None else board.first_id
        ids = board.ids if board.ids is not None else list(range(start, start + board.rows * board.columns))
        for marker_id in ids:
            _check_id(marker_id, dictionary, place, origin)
        r, laid = board.r_ned_from_marker, board.laid(board.sheet or f"board {index + 1}", file.defaults)
        result += [
            PlacedMarker(
                place=f"{place} marker {n}",
                dictionary=dictionary,
                id=marker_id,
                size_m=size_m,
                center_ned_m=np.array(board.center_m) + r @ offset,
                r_ned_from_marker=r,
                laid=laid,
            )
            for n, (offset, marker_id) in enumerate(zip(board_offsets(board, size_m), ids, strict=True))
        ]
    return result


def board_offsets(board: BoardEntry, size_m: float) -> FloatArray:
    """(rows * columns, 3) centres of a board's markers in the board's frame."""
    pitch = size_m + board.gap_m
    down, right = np.divmod(np.arange(board.rows * board.columns), board.columns)
    result = np.zeros((board.rows * board.columns, 3))
    result[:, 0] = pitch * (0.5 * (board.rows - 1) - down)
    result[:, 1] = pitch * (right - 0.5 * (board.columns - 1))
    return result


def _kind(entry: MapEntry, defaults: Defaults, place: str, folder: Path, origin: str) -> tuple[str, float]:
    """Dictionary and size of an entry."""
    dictionary = entry.dictionary if entry.dictionary is not None else defaults.dictionary
    size_m = entry.size_m if entry.size_m is not None else defaults.size_m
    for key, value in (("dictionary", dictionary), ("size_m", size_m)):
        if value is None:
            raise ConfigError(f"{origin}: `{place}` has no `{key}`; give it there or in [defaults]")
    assert dictionary is not None
    assert size_m is not None
    return resolve_dictionary(dictionary, folder, f"{origin}: `{place}.dictionary`"), size_m


def _check_id(marker_id: int, dictionary: str, place: str, origin: str) -> None:
    count = dictionary_size(dictionary) or 0
    if marker_id >= count:
        raise ConfigError(
            f"{origin}: `{place}`: id {marker_id} is not in {dictionary_label(dictionary)}; use 0 to {count - 1} or a"
            " larger dictionary"
        )


def _whole_dictionaries(names: set[str]) -> dict[str, str]:
    """Dictionary -> the largest one used that begins with the same patterns (DICT_4X4_50 is in DICT_4X4_1000)."""

    def family(name: str) -> str:
        head, _, count = name.rpartition("_")
        return head if count.isdigit() else name

    largest: dict[str, str] = {}
    for name in sorted(names, key=lambda name: dictionary_size(name) or 0):
        largest[family(name)] = name
    return {name: largest[family(name)] for name in names}


def _refuse_duplicates(markers: MarkerMap, placed: Sequence[PlacedMarker], origin: str) -> None:
    """ConfigError for two markers of one id that the estimator could take for each other."""
    order = np.argsort(markers.ids, kind="stable")
    starts = np.flatnonzero(np.diff(markers.ids[order], prepend=-1))
    for group in np.split(order, starts[1:]):
        centers = markers.centers_ned_m[group]
        for k in range(1, len(group)):
            distance_m = np.linalg.norm(centers[:k] - centers[k], axis=1)
            nearest = int(distance_m.argmin())
            if distance_m[nearest] < AMBIGUITY_M:
                raise ConfigError(
                    f"{origin}: {placed[group[k]].label} is {distance_m[nearest]:.3f} m from"
                    f" {placed[group[nearest]].label}; markers of one id must lie {AMBIGUITY_M:g} m apart:"
                    " change the id or remove one"
                )


def _refuse_overlaps(markers: MarkerMap, placed: Sequence[PlacedMarker], origin: str) -> None:
    """ConfigError for two markers that cover each other by more than their sheets may be off."""
    errors = markers.errors
    for i, j in close_pairs(markers, 0.0):
        slack_m = 0.0
        if errors is not None and errors.sheet[i] != errors.sheet[j]:
            pair = [int(errors.sheet[i]), int(errors.sheet[j])]
            if all(k >= 0 and k not in errors.loose for k in pair):
                slack_m = OVERLAP_SIGMAS * float(np.linalg.norm(errors.sigma[pair, 0]))
        if _overlap(placed[i], placed[j], slack_m):
            raise ConfigError(
                f"{origin}: {placed[i].label} and {placed[j].label} overlap, their centres are"
                f" {np.linalg.norm(placed[i].center_ned_m - placed[j].center_ned_m):.3f} m apart; move one of them"
            )


def close_pairs(markers: MarkerMap, gap_m: float) -> list[tuple[int, int]]:
    """Pairs of markers whose circumscribed circles are less than ``gap_m`` apart."""
    reach = markers.sizes_m * math.sqrt(0.5)
    order = np.argsort(markers.centers_ned_m[:, 0], kind="stable")
    north = markers.centers_ned_m[order, 0]
    widest = 2.0 * float(reach.max()) + gap_m
    ends = np.searchsorted(north, north + widest, side="right")
    pairs = []
    for k, end in enumerate(ends.tolist()):
        i, others = order[k], order[k + 1 : end]
        apart = np.linalg.norm(markers.centers_ned_m[others] - markers.centers_ned_m[i], axis=1)
        pairs += [(int(i), int(j)) for j in others[apart < reach[others] + reach[i] + gap_m]]
    return pairs


def _overlap(a: PlacedMarker, b: PlacedMarker, slack_m: float) -> bool:
    """Whether the square of ``b`` covers more than ``slack_m`` of that of ``a``, by the separating axes of the two in
    a's plane."""
    in_a = (b.corners_ned_m - a.center_ned_m) @ a.r_ned_from_marker
    if np.abs(in_a[:, 2]).min() > FLAT_M:
        return False
    slack = slack_m + 1e-6
    square = 0.5 * a.size_m * CORNER_SIGNS
    other = in_a[:, :2]
    for corners in (square, other):
        for axis in (corners[1] - corners[0], corners[2] - corners[1]):
            length = float(np.hypot(*axis))
            if length < 1e-9:
                continue
            ours, theirs = square @ axis / length, other @ axis / length
            if ours.max() <= theirs.min() + slack or theirs.max() <= ours.min() + slack:
                return False
    return True


def placed_markers(markers: MarkerMap) -> list[PlacedMarker]:
    """The markers of a map one by one; the poses are those of the squares that fit the corners best."""
    result = []
    sizes_m = markers.sizes_m.tolist()
    laid = _laid_of(markers)
    for code, corners, size_m, how in zip(markers.ids.tolist(), markers.corners_ned_m, sizes_m, laid, strict=True):
        kind, marker_id = divmod(code, ID_SPAN)
        r = rotation_of(corners)
        result.append(
            PlacedMarker(
                place="",
                dictionary=markers.dictionaries[kind],
                id=marker_id,
                size_m=size_m,
                center_ned_m=corners.mean(axis=0),
                r_ned_from_marker=r,
                laid=how,
            )
        )
    return result


def _laid_of(markers: MarkerMap) -> list[Laid]:
    """Stated laying accuracy of each marker."""
    errors = markers.errors
    if errors is None:
        return [NOTHING_SAID] * len(markers.ids)
    sheets = [
        Laid(sheet=name, sigma_m=float(sigma[:2].max()), sigma_rad=float(sigma[3]))
        for name, sigma in zip(errors.names, errors.sigma, strict=True)
    ]
    alone = [Laid(sigma_m=float(sigma)) for sigma in errors.marker_sigma_m]
    exact = Laid(sigma_m=0.0)
    return [
        exact if k < 0 else alone[n] if k in errors.loose else sheets[k] for n, k in enumerate(errors.sheet.tolist())
    ]


def rotation_of(corners_m: FloatArray) -> FloatArray:
    """(3, 3) rotation of the marker frame whose square lies closest to corners (4, 3), by Kabsch's method."""
    flat = np.column_stack((CORNER_SIGNS, np.zeros(4)))
    u, _, vt = np.linalg.svd((corners_m - corners_m.mean(axis=0)).T @ flat)
    turn: FloatArray = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return turn


def marker_file_text(markers: MarkerMap, notes: Sequence[str] = (), remarks: Sequence[str] = ()) -> str:
    """TOML that :func:`load_marker_map` reads back as the same map (to 1e-6 m).

    ``notes`` are comment lines for the head, ``remarks`` comments for each marker.
    """
    placed = placed_markers(markers)
    size_m = round(markers.size_m, 6)
    lines = [*(f"# {note}" for note in notes), "", "[defaults]", f'dictionary = "{markers.dictionary}"']
    lines.append(f"size_m = {size_m!r}")
    lines.append(f"scale_sigma = {_number(markers.scale_sigma, 6)}")
    across, down, turn = (0.0, 0.0, 0.0) if markers.errors is None else markers.errors.frame_sigma
    down = math.hypot(down, markers.depth_sigma_m)
    lines += ["", "[frame]", f"sigma_m = {_number(across, 6)}", f"sigma_down_m = {_number(down, 6)}"]
    lines.append(f"sigma_rad = {_number(turn, 7)}")
    for n, marker in enumerate(placed):
        lines += ["", "[[marker]]" + (f" # {remarks[n]}" if remarks else ""), f"id = {marker.id}"]
        if marker.dictionary != markers.dictionary:
            lines.append(f'dictionary = "{marker.dictionary}"')
        if abs(marker.size_m - size_m) > 1e-6:
            lines.append(f"size_m = {round(marker.size_m, 6)!r}")
        lines.append(f"center_m = {_numbers(marker.center_ned_m, 6)}")
        rpy = rpy_from_r(marker.r_ned_from_marker)
        if np.abs(rpy[:2]).max() < 1e-7:
            lines.append(f"yaw_rad = {_number(rpy[2], 7)}")
        else:
            lines.append(f"rpy_rad = {_numbers(rpy, 7)}")
        if marker.laid.sheet is not None:
            lines.append(f"sheet = {json.dumps(marker.laid.sheet)}")
        if marker.laid.sigma_m is not None:
            lines.append(f"sigma_m = {_number(marker.laid.sigma_m, 6)}")
        if marker.laid.sigma_rad is not None:
            lines.append(f"sigma_rad = {_number(marker.laid.sigma_rad, 7)}")
    return "\n".join(lines).lstrip("\n") + "\n"


def _number(value: Any, digits: int) -> str:
    return repr(round(float(value), digits) + 0.0)


def _numbers(values: FloatArray, digits: int) -> str:
    return "[" + ", ".join(_number(v, digits) for v in values) + "]"
