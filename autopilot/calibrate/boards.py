"""Calibration boards (ChArUco, plain markers, plain chessboards): detection by OpenCV, and sheets at true scale.

Works with OpenCV 4.10 to 5.x, whose arrays differ in shape (ids and matched points are flattened here).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from autopilot.calibrate.calibrate_tuning import BOARDS
from autopilot.core.dictionaries import black_runs, opencv_dictionary, resolve_dictionary
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardSpec:
    """A flat board of ``columns`` x ``rows`` squares (ChArUco, chessboard) or markers (grid)."""

    kind: Literal["charuco", "grid", "chessboard"] = "charuco"
    columns: int = 9
    rows: int = 6
    pitch_m: float = 0.030
    """Side of a chess square; of a grid, from marker to marker."""
    marker_m: float = 0.022
    """Side of a marker's black square."""
    dictionary: str = "DICT_5X5_100"
    legacy: bool = False
    """ChArUco as OpenCV drew it before 4.6 (differs for an even number of rows)."""

    def __post_init__(self) -> None:
        smallest = {"charuco": 3, "chessboard": 4}.get(self.kind, 1)
        if min(self.columns, self.rows) < smallest:
            raise ConfigError(f"board of {self.columns} x {self.rows}: too small; use at least {smallest} x {smallest}")
        least_m, most_m = BOARDS.pitch_m
        if not least_m <= self.pitch_m <= most_m:
            raise ConfigError(f"squares of {self.pitch_m:g} m; give --square in metres, {least_m:g} to {most_m:g}")
        if self.kind != "chessboard" and not 0.0 < self.marker_m < self.pitch_m:
            raise ConfigError(
                f"marker of {self.marker_m:g} m must lie between 0 and the pitch, {self.pitch_m:g} m; measure the print"
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the pattern."""
        if self.kind != "grid":
            return self.columns * self.pitch_m, self.rows * self.pitch_m
        gap_m = self.pitch_m - self.marker_m
        return self.columns * self.pitch_m - gap_m, self.rows * self.pitch_m - gap_m


def parse_shape(text: str) -> tuple[int, int]:
    """``9x6`` as (columns, rows). ConfigError for anything else."""
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise ConfigError(f"board shape {text!r} is not COLUMNSxROWS; write for example 9x6")
    return int(columns), int(rows)


class CalibrationBoard:
    """A board that can be found in images."""

    def __init__(self, spec: BoardSpec) -> None:
        """ConfigError if the dictionary (OpenCV's name or a file) is not known or has too few markers."""
        self.spec = spec
        self.pattern: Any = None
        self._detector: Any = None
        if spec.kind == "chessboard":
            return
        self.dictionary: Any = opencv_dictionary(resolve_dictionary(spec.dictionary, Path(), "--dictionary"))
        needed = spec.columns * spec.rows // (2 if spec.kind == "charuco" else 1)
        if needed > len(self.dictionary.bytesList):
            raise ConfigError(
                f"board of {spec.columns} x {spec.rows} needs {needed} markers, {spec.dictionary} has"
                f" {len(self.dictionary.bytesList)}; use a larger dictionary"
            )
        shape = (spec.columns, spec.rows)
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        parameters.relativeCornerRefinmentWinSize = BOARDS.refine_cells
        if spec.kind == "charuco":
            self.pattern = cv2.aruco.CharucoBoard(shape, spec.pitch_m, spec.marker_m, self.dictionary)
            self.pattern.setLegacyPattern(spec.legacy)
            self._detector = cv2.aruco.CharucoDetector(self.pattern)
            self._detector.setDetectorParameters(parameters)
        else:
            gap_m = spec.pitch_m - spec.marker_m
            self.pattern = cv2.aruco.GridBoard(shape, spec.marker_m, gap_m, self.dictionary)
            self._detector = cv2.aruco.ArucoDetector(self.dictionary, parameters)

    def find(self, grey: Any) -> tuple[FloatArray, FloatArray] | None:
        """Board points (n, 3) [m] and their pixels (n, 2) in a grey image; None if fewer than MIN_CORNERS are seen."""
        if self.spec.kind == "chessboard":
            return self._find_chessboard(grey)
        if self.spec.kind == "charuco":
            pixels, ids, _, _ = self._detector.detectBoard(grey)
            if ids is None or len(ids) < BOARDS.min_corners:
                return None
            points = np.asarray(self.pattern.getChessboardCorners(), dtype=float)[np.asarray(ids).ravel()]
        else:
            corners, ids, _ = self._detector.detectMarkers(grey)
            if ids is None or len(ids) == 0:
                return None
            points, pixels = self.pattern.matchImagePoints(corners, ids)
            if points is None or len(points) < BOARDS.min_corners:
                return None
        return np.asarray(points, dtype=float).reshape(-1, 3), np.asarray(pixels, dtype=float).reshape(-1, 2)

    def _find_chessboard(self, grey: Any) -> tuple[FloatArray, FloatArray] | None:
        """All inner corners, or None. Which of a board's ends is its first is not known; a camera does not mind."""
        across, down = self.spec.columns - 1, self.spec.rows - 1
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
        found, pixels = cv2.findChessboardCornersSB(grey, (across, down), flags=flags)
        if not found or pixels is None or len(pixels) != across * down:
            return None
        row, column = np.divmod(np.arange(across * down), across)
        points = self.spec.pitch_m * np.column_stack((column + 1.0, row + 1.0, np.zeros(across * down)))
        return points, np.asarray(pixels, dtype=float).reshape(-1, 2)

    def black_rectangles_m(self) -> list[tuple[float, float, float, float]]:
        """Everything black: left, top, width, height, from the pattern's top left corner, y down."""
        spec = self.spec
        if spec.kind == "chessboard":
            squares = [(column, row) for row in range(spec.rows) for column in range(spec.columns)]
            side = spec.pitch_m
            return [(c * side, r * side, side, side) for c, r in squares if (c + r) % 2 == 0]
        cells = int(self.dictionary.markerSize) + 2
        cell_m = spec.marker_m / cells
        out = []
        corners = [np.asarray(quad, dtype=float).reshape(4, 3) for quad in self.pattern.getObjPoints()]
        if spec.kind == "charuco":
            taken = {tuple(int(v) for v in quad.mean(axis=0)[:2] // spec.pitch_m) for quad in corners}
            for row in range(spec.rows):
                for column in range(spec.columns):
                    if (column, row) not in taken:
                        square = (column * spec.pitch_m, row * spec.pitch_m, spec.pitch_m, spec.pitch_m)
                        out.append(square)
        for quad, number in zip(corners, np.asarray(self.pattern.getIds()).ravel(), strict=True):
            left, top = quad[:, :2].min(axis=0)
            for row, start, end in black_runs(self.dictionary, int(number)):
                out.append((left + start * cell_m, top + row * cell_m, (end - start) * cell_m, cell_m))
        return out

    def svg(self) -> str:
        """The board as a sheet that prints at true scale, with a line to check that."""
        width_mm, height_mm = (1e3 * side + 2.0 * BOARDS.quiet_mm for side in self.spec.size_m)
        page_mm = max(width_mm, BOARDS.scale_bar_mm + 2.0 * BOARDS.quiet_mm)
        path = "".join(
            f"M{1e3 * x + BOARDS.quiet_mm:.4f}"
            f" {1e3 * y + BOARDS.quiet_mm:.4f}h{1e3 * w:.4f}v{1e3 * h:.4f}h{-1e3 * w:.4f}z"
            for x, y, w, h in self.black_rectangles_m()
        )
        spec = self.spec
        markers = f", marker {1e3 * spec.marker_m:g} mm, {spec.dictionary}{' legacy' if spec.legacy else ''}"
        label = (
            f"{spec.kind} {spec.columns}x{spec.rows}, pitch {1e3 * spec.pitch_m:g} mm"
            f"{'' if spec.kind == 'chessboard' else markers}; at 100 % this line is {BOARDS.scale_bar_mm:g} mm"
        )
        bar_mm = height_mm + 3.0
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{page_mm:.3f}mm" height="{height_mm + 12.0:.3f}mm"'
            f' viewBox="0 0 {page_mm:.3f} {height_mm + 12.0:.3f}">\n'
            '<rect width="100%" height="100%" fill="white"/>\n'
            f'<path d="{path}" fill="black" shape-rendering="crispEdges"/>\n'
            f'<path d="M{BOARDS.quiet_mm} {bar_mm - 2}v4m0-2h{BOARDS.scale_bar_mm}m0-2v4" stroke="black"'
            ' stroke-width="0.2"'
            ' fill="none"/>\n'
            f'<text x="{BOARDS.quiet_mm}" y="{bar_mm + 5}" font-family="sans-serif" font-size="3">{label}</text>\n'
            "</svg>\n"
        )
