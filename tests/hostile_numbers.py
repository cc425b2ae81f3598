"""Numbers that are none, or nearly none, and what a compiled function has to make of them: what the code that says what
it means makes of them."""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from autopilot.core.frames import FloatArray

HOSTILE = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -5e-324)
Answer: TypeAlias = FloatArray | float


def with_one(rng: np.random.Generator, array: FloatArray, value: float) -> FloatArray:
    """A copy with one of its numbers replaced."""
    copy = np.array(array, dtype=float)
    copy.flat[rng.integers(copy.size)] = value
    return copy


def outcome(function: Callable[..., Answer | tuple[float, ...]], *given: object) -> Answer:
    """An answer; NaN for an exception: Python raises where the compiled code gives something that is not finite."""
    with np.errstate(all="ignore"):
        try:
            return np.array(function(*given))
        except (ArithmeticError, ValueError):
            return math.nan


def agree(ours: Answer, theirs: Answer, tolerance: float = 1e-9) -> bool:
    """Whether both are finite at the same places, and the same there: no number is made of what is none."""
    mine, other = np.broadcast_arrays(np.asarray(ours, dtype=float), np.asarray(theirs, dtype=float))
    finite = np.isfinite(mine)
    if np.ndim(theirs) == 0 and not np.isfinite(theirs):  # raised or NaN as a whole
        return not finite.all()
    same = bool((finite == np.isfinite(other)).all())
    return same and np.allclose(mine[finite], other[finite], rtol=tolerance, atol=tolerance)
