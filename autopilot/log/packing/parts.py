"""Common parts of the packers: header frames, and clipping to the range of a field."""

from collections.abc import Sequence

import numpy as np

from autopilot.core.frames import FloatArray

NED = (4, b"ned\0")
FRD = (4, b"frd\0")
NS = 1_000_000_000
"""Nanoseconds in a second."""
UINT16, UINT32 = 0xFFFF, 0xFFFFFFFF
"""Largest values of the types."""


def clip(value: int, largest: int) -> int:
    """A count as an unsigned field holds it: 0 .. ``largest``."""
    return 0 if value < 0 else min(value, largest)


def padded(values: FloatArray | Sequence[float], count: int) -> Sequence[float]:
    """Values padded with zeros, or truncated, to a fixed length."""
    flat: Sequence[float] = values.tolist() if isinstance(values, np.ndarray) else values
    return flat if len(flat) == count else [*flat, *[0] * count][:count]
