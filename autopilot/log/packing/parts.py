"""What the packers of all topics have in common: frames of the header, and values cut to what a field holds."""

from autopilot.core.frames import FloatArray
from autopilot.core.messages import MAX_THRUSTERS

NED = (4, b"ned\0")
FRD = (4, b"frd\0")
NS = 1_000_000_000
"""Nanoseconds in a second."""
UINT16, UINT32 = 0xFFFF, 0xFFFFFFFF
"""Largest values of the types."""


def clip(value: int, largest: int) -> int:
    """A count as an unsigned field holds it: 0 .. ``largest``."""
    return 0 if value < 0 else min(value, largest)


def eight(values: FloatArray) -> list[float]:
    """Values (n,) per thruster as the MAX_THRUSTERS of a message, the rest 0."""
    out: list[float] = values.tolist()
    return out if len(out) == MAX_THRUSTERS else (out + [0.0] * MAX_THRUSTERS)[:MAX_THRUSTERS]
