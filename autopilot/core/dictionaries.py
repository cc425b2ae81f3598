"""Marker dictionaries: OpenCV's predefined ones by name, and custom ones from files.

A dictionary is identified by its name. The name of a custom one contains its patterns, so that maps, logs and replays
need no second file: ``CUSTOM:<cells>:<patterns in hexadecimal>``. For display: :func:`dictionary_label`.
"""

import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.errors import ConfigError

DICTIONARY_SIZES = {
    **{f"DICT_{n}X{n}_{count}": count for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_ARUCO_MIP_36h12": 250,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
}
"""Predefined OpenCV dictionaries that a map can use, and how many ids each has."""

CUSTOM = "CUSTOM:"
MAX_WORDS = 1000
CELLS = (3, 8)
"""Least and most cells along the side of a custom marker, border not counted."""
FILE_ENDINGS = (".yml", ".yaml")
_LINE = re.compile(r'^\s*(nmarkers|markersize|marker_(\d+))\s*:\s*"?([01]+|\d+)"?\s*$')


def black_runs(dictionary: Any, marker_id: int) -> list[tuple[int, int, int]]:
    """Runs of black cells of a marker with its border: row, first column, column behind the last."""
    import cv2

    cells = dictionary.markerSize + 2
    black = cv2.aruco.generateImageMarker(dictionary, marker_id, cells) == 0
    rows, edges = np.nonzero(np.diff(np.pad(black.astype(np.int8), ((0, 0), (1, 1)))))
    return list(zip(rows[::2].tolist(), edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def resolve_dictionary(name: str, folder: Path, origin: str) -> str:
    """The name under which a dictionary goes everywhere: of a predefined one its own, of a file (relative to
    ``folder``) one that holds its patterns. ConfigError begins with ``origin``."""
    if name in DICTIONARY_SIZES:
        return name
    if name.startswith(CUSTOM):
        _codewords(name)
        return name
    if name.lower().endswith(FILE_ENDINGS):
        return read_dictionary(folder / name)
    raise ConfigError(
        f"{origin} {name!r} is not known; use a file that OpenCV's Dictionary.writeDictionary made (.yml) or one of"
        f" {', '.join(DICTIONARY_SIZES)}"
    )


def read_dictionary(path: Path) -> str:
    """The name of a dictionary in OpenCV's file format (nmarkers, markersize, marker_0 ...). ConfigError if
    it is none."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is no dictionary file ({error}); give one of OpenCV's format") from error
    found = {match[1]: match[3] for match in map(_LINE.match, text.splitlines()) if match}
    for key in ("nmarkers", "markersize"):
        if not found.get(key, "").isdecimal():
            raise ConfigError(f"{path}: has no `{key}`; write the file with OpenCV's Dictionary.writeDictionary")
    count, cells = int(found["nmarkers"]), int(found["markersize"])
    if not 1 <= count <= MAX_WORDS or not CELLS[0] <= cells <= CELLS[1]:
        raise ConfigError(
            f"{path}: {count} markers of {cells} x {cells} cells; use 1 to {MAX_WORDS} with {CELLS[0]} to {CELLS[1]}"
        )
    codewords = []
    for k in range(count):
        bits = found.get(f"marker_{k}", "")
        if len(bits) != cells * cells:
            raise ConfigError(
                f"{path}: `marker_{k}` has {len(bits)} cells of {cells * cells}; give one 0 or 1 for each, row by row"
            )
        codewords.append(bits)
    name = f"{CUSTOM}{cells}:" + "".join(f"{int(bits, 2):0{_digits(cells)}x}" for bits in codewords)
    if least_distance(name) == 0:
        raise ConfigError(f"{path}: two markers are alike, or one looks the same turned; leave it out")
    return name


def dictionary_size(name: str) -> int | None:
    """Number of ids of a dictionary, None if unknown."""
    return len(_codewords(name)) if name.startswith(CUSTOM) else DICTIONARY_SIZES.get(name)


def dictionary_label(name: str) -> str:
    if not name.startswith(CUSTOM):
        return name
    codewords = _codewords(name)
    return f"custom {len(codewords[0])}x{len(codewords[0])} of {len(codewords)}"


@lru_cache(maxsize=16)
def _codewords(name: str) -> np.ndarray:
    """(n, cells, cells) of 0 and 1."""
    cells_text, _, digits = name.removeprefix(CUSTOM).partition(":")
    cells = int(cells_text) if cells_text.isdecimal() else 0
    step = _digits(cells)
    if not CELLS[0] <= cells <= CELLS[1] or not digits or len(digits) % step or not re.fullmatch("[0-9a-f]+", digits):
        raise ConfigError(f"dictionary {name[:40]!r} is damaged; give its file again")
    codewords = [int(digits[k : k + step], 16) for k in range(0, len(digits), step)]
    bits = [[(codeword >> (cells * cells - 1 - b)) & 1 for b in range(cells * cells)] for codeword in codewords]
    return np.array(bits, dtype=np.uint8).reshape(-1, cells, cells)


def _digits(cells: int) -> int:
    """Hexadecimal digits of one pattern."""
    return -(-cells * cells // 4)


@lru_cache(maxsize=16)
def least_distance(name: str) -> int:
    """Cells by which two markers of a custom dictionary differ at least, however they are turned, and one from itself
    turned."""
    codewords = _codewords(name)
    signs = 2.0 * codewords.reshape(len(codewords), -1) - 1.0
    least = float(signs.shape[1])
    for turns in range(4):
        turned = 2.0 * np.rot90(codewords, turns, axes=(1, 2)).reshape(len(codewords), -1) - 1.0
        apart = 0.5 * (signs.shape[1] - signs @ turned.T)
        if turns == 0:
            np.fill_diagonal(apart, signs.shape[1])
        least = min(least, float(apart.min()))
    return round(least)


def opencv_dictionary(name: str) -> Any:
    """OpenCV's dictionary of that name, with the number of correctable cells that its distances allow. ConfigError if
    OpenCV does not have it.
    """
    import cv2  # heavy, and only who prints or finds markers needs it

    if name.startswith(CUSTOM):
        codewords = _codewords(name)
        coded = np.concatenate([cv2.aruco.Dictionary.getByteListFromBits(codeword) for codeword in codewords])
        return cv2.aruco.Dictionary(coded, codewords.shape[1], (least_distance(name) - 1) // 2)
    if not name.startswith("DICT_") or not hasattr(cv2.aruco, name):
        raise ConfigError(f"marker dictionary {name!r} is not known to OpenCV; use e.g. DICT_4X4_1000")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
