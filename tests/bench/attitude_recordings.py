"""Recorded raw sensors with optical truth: trials of BROAD as `tests/data/SOURCES.md` tells, and any in that form."""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from tests.bench.attitude_motions import Recording

FOLDER = Path(__file__).resolve().parents[1] / "data" / "broad"
"""Where a checkout has them."""
RATE_HZ = 2000.0 / 21.0
"""Of the means of three samples."""
MAG_EVERY, TRUE_EVERY = 3, 5
SCALES = {"rate_frd_rad_s": 1 / 1800, "accel_frd_m_s2": 1 / 500, "mag_frd_ut": 1 / 400, "quat_enu_from_flu": 1 / 32000}
"""Name -> what one count stands for."""
UNKNOWN = -32768
NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])


@cache
def load_trials(folder: Path = FOLDER) -> tuple[Recording, ...]:
    """All in a folder, by name; LogError if one of them is something else."""
    return tuple(_load(path) for path in sorted(folder.glob("trial_*.npz")))


def _load(path: Path) -> Recording:
    try:
        with np.load(path) as kept:
            rate, accel, magnet, quat = (_counts(kept[name]) * scale for name, scale in SCALES.items())
            moving = np.unpackbits(kept["moving"])[: len(quat)].astype(bool)
    except (OSError, KeyError, ValueError) as error:
        raise LogError(f"{path}: is no recording of the form that tests/data/SOURCES.md tells ({error})") from error
    true = NED_FROM_ENU @ _matrices(quat) @ FLU_FROM_FRD
    return Recording(
        name=path.stem.removeprefix("trial_").replace("_", " "),
        rate_hz=RATE_HZ,
        rate_frd_rad_s=rate,
        accel_frd_m_s2=accel,
        mag_frd=magnet,
        mag_every=MAG_EVERY,
        true=true,
        true_every=TRUE_EVERY,
        counts=moving & np.isfinite(true).all(axis=(1, 2)),
    )


def _counts(kept: NDArray[np.int16]) -> FloatArray:
    """Differences from sample to sample (modulo 2^16) back to counts."""
    counts = np.cumsum(kept, axis=0, dtype=np.int16)
    return np.where(counts == UNKNOWN, np.nan, counts)


def _matrices(quat: FloatArray) -> FloatArray:
    """(n, 3, 3) of (n, 4) w, x, y, z."""
    w, x, y, z = (quat / np.linalg.norm(quat, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    result: FloatArray = np.array(rows).transpose(2, 0, 1)
    return result
