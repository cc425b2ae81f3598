"""How a vehicle swings under way, from its file of true poses."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from autopilot.core.frames import FloatArray

ROW_S = 0.1
MEAN_S = 2.0
"""Of the mean that is taken off, about a swing of a BlueROV2: a pitch that steady thrust holds is no swing."""
ROLL, PITCH, OUTPUTS = 4, 5, slice(7, None)
NEUTRAL_US = (0, 1500)


class Swings(NamedTuple):
    pitch_rms_rad: float
    pitch_p99_rad: float
    """Less the mean over :data:`MEAN_S`, while a thruster turns."""
    tilt_rad: float
    """Greatest roll or pitch, as it is."""


def swings(truth: Path) -> Swings:
    """Of a whole file, the last line of which may be cut."""
    lines = truth.read_text().splitlines()
    return swung(np.array([json.loads(line) for line in lines if line.endswith("]")], dtype=float))


def swung(rows: FloatArray) -> Swings:
    """(n, 7 + outputs) as in the file, :data:`ROW_S` apart. ValueError if nothing turned for :data:`MEAN_S`."""
    width = round(MEAN_S / ROW_S) + 1
    turning = ~np.isin(rows[:, OUTPUTS], NEUTRAL_US).all(axis=1)
    first, last = np.flatnonzero(turning)[[0, -1]] if turning.any() else (0, 0)
    rows = rows[first : last + 1]
    if len(rows) < width:
        raise ValueError(f"nothing turns for {MEAN_S:g} s")
    pitch, half = rows[:, PITCH], width // 2
    swing = (pitch[half : len(pitch) - half] - np.convolve(pitch, np.full(width, 1.0 / width), "valid")).astype(float)
    return Swings(
        pitch_rms_rad=float(np.sqrt((swing**2).mean())),
        pitch_p99_rad=float(np.quantile(np.abs(swing), 0.99)),
        tilt_rad=float(np.abs(rows[:, [ROLL, PITCH]]).max()),
    )
