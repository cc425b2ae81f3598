"""Views of a calibration board: from a folder of images, or from a camera or video of a moving board."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from autopilot.calibrate.boards import CalibrationBoard
from autopilot.calibrate.calibrate_tuning import VIEWS
from autopilot.core.disk import write_result
from autopilot.core.errors import ConfigError, DriverError, SourceError
from autopilot.core.frames import FloatArray

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".webp")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardView:
    name: str
    points_m: FloatArray
    """(n, 3) on the board."""
    pixels: FloatArray
    """(n, 2)"""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Views:
    width_px: int
    height_px: int
    views: tuple[BoardView, ...]
    left_out: tuple[tuple[str, str], ...]
    """Image and why."""


def image_files(folder: Path, instead: str = "") -> list[Path]:
    """Images of a folder by name. SourceError without any. ``instead``: what else would do, e.g. "or a film"."""
    wanted = f"give the folder that holds the images{instead}"
    if not folder.is_dir():
        kind = "is not a folder" if folder.exists() else "does not exist"
        kind = "is one image" if is_image(folder) else kind
        raise SourceError(f"{folder}: {kind}; {wanted}")
    files = sorted(path for path in folder.iterdir() if is_image(path))
    if not files:
        raise SourceError(f"{folder}: holds no images ({', '.join(SUFFIXES[:3])}); {wanted}")
    return files


def is_image(path: Path) -> bool:
    """Whether it is a file with the ending of an image."""
    return path.suffix.lower() in SUFFIXES and path.is_file()


def read_images(files: Iterable[Path], flag: int = cv2.IMREAD_GRAYSCALE) -> Iterable[tuple[str, Any]]:
    """Name and pixels of each file, None for one that OpenCV cannot read."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    for path in files:
        yield path.name, cv2.imread(str(path), flag)


def collect_views(board: CalibrationBoard, images: Iterable[tuple[str, Any]], origin: str) -> Views:
    """Find the board in images. ConfigError if their sizes differ or no image shows the board, SourceError if none can
    be read."""
    size: tuple[int, int] | None = None
    first = ""
    views, left_out = [], []
    for name, grey in images:
        if grey is None:
            left_out.append((name, "cannot be read"))
            continue
        height, width = grey.shape[:2]
        if size is None:
            size, first = (width, height), name
        elif size != (width, height):
            raise ConfigError(
                f"{origin}: {name} has {width} x {height} pixels, {first} has {size[0]} x {size[1]};"
                " use images of one camera mode only"
            )
        found = board.find(grey)
        if found is None:
            left_out.append((name, "board not found"))
        else:
            views.append(BoardView(name=name, points_m=found[0], pixels=found[1]))
    if left_out and size is None:
        raise none_readable(origin, [name for name, _ in left_out])
    if not views:
        dictionary = "" if board.spec.kind == "chessboard" else f" {board.spec.dictionary}"
        shape = f"{board.spec.kind} {board.spec.columns}x{board.spec.rows}{dictionary}"
        where = f"none of {len(left_out)} images" if left_out else "no frame, sharp and at rest"
        raise ConfigError(
            f"{origin}: the board ({shape}) is seen in {where}; check --board, --shape,"
            " --dictionary and --legacy against the print"
        )
    assert size is not None
    return Views(width_px=size[0], height_px=size[1], views=tuple(views), left_out=tuple(left_out))


def none_readable(origin: object, names: Sequence[str]) -> SourceError:
    some = ", ".join(names[:3])
    return SourceError(f"{origin}: OpenCV reads none of {len(names)} images ({some}); give JPEG or PNG files")


def live_images(board: CalibrationBoard, source: str, wanted: int, folder: Path | None) -> Iterable[tuple[str, Any]]:
    """Different, unblurred views from a V4L2 device (``/dev/video0``) or a film; saved into ``folder`` if given.

    DriverError if it cannot be opened, SourceError if it is no film."""
    capture = cv2.VideoCapture(source, cv2.CAP_V4L2 if source.startswith("/dev/") else cv2.CAP_ANY)
    if not capture.isOpened() and not source.startswith("/dev/"):
        raise SourceError(
            f"{source}: is not a film that OpenCV reads; give a film, or the folder that holds the images"
        )
    if not capture.isOpened():
        raise DriverError(f"camera {source}: cannot be opened; check the name (ls /dev/video*) and who else uses it")
    taken: list[FloatArray] = []
    before: FloatArray | None = None
    try:
        for number in range(VIEWS.max_live_frames):
            ok, frame = capture.read()
            if not ok or len(taken) >= wanted:
                return
            grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
            found = board.find(grey)
            place = None if found is None else _place(board, *found)
            if place is not None and before is not None and _apart(place, before) < VIEWS.still_px:
                far = VIEWS.new_view_fraction * grey.shape[1]
                if all(_apart(place, other) > far for other in taken):
                    taken.append(place)
                    name = f"frame{number:05d}.png"
                    if folder is not None:
                        write_result(folder / name, cv2.imencode(".png", grey)[1].tobytes(), folder=True)
                    yield name, grey
            before = place
    finally:
        capture.release()


def _place(board: CalibrationBoard, points_m: FloatArray, pixels: FloatArray) -> FloatArray | None:
    """Pixels (4, 2) of the board's four corners by a homography, None if it is degenerate."""
    matrix, _ = cv2.findHomography(points_m[:, :2], pixels)
    if matrix is None:
        return None
    width_m, height_m = board.spec.size_m
    corners = np.array([[0.0, 0.0, 1.0], [width_m, 0.0, 1.0], [width_m, height_m, 1.0], [0.0, height_m, 1.0]])
    homogeneous = corners @ np.asarray(matrix, dtype=float).T
    result: FloatArray = homogeneous[:, :2] / homogeneous[:, 2:]
    return result


def _apart(a: FloatArray, b: FloatArray) -> float:
    """Largest distance between corresponding corners [px]."""
    return float(np.hypot(*(a - b).T).max())
