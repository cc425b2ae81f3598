"""Arrays that a program hands over, and the bounds that hold for them."""

from collections.abc import Sequence

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle


def finite(name: str, given: Sequence[float] | FloatArray, size: int) -> FloatArray:
    """(size,) a copy; ConfigError, which begins with ``name``, unless it is so many finite numbers."""
    try:
        values = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name}={given!r} is no array of numbers ({error})") from error
    if values.shape != (size,) or not np.isfinite(values).all():
        raise ConfigError(f"{name}={values.tolist()!r} must be {size} finite numbers")
    return values


def is_number(given: object) -> bool:
    """Of Python or numpy."""
    return isinstance(given, int | float | np.number)


def thrust_limit_n(vehicle: Vehicle, params: ParamSet) -> FloatArray:
    """(N,) largest thrust, either way, that is commanded at nominal supply [N]."""
    return np.array([min(params["THR_LIMIT"], each.limit_n) for each in vehicle.thrusters])
