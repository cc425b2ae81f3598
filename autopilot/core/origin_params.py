"""The local origin as parameters: degrees as a 32-bit float, and the remainder in 1e-7 degrees.

A 32-bit float of degrees alone changes a position by up to 0.4 m when a client saves and restores it.
"""

import math
import struct
from collections.abc import Mapping

from autopilot.core.geodesy import DEG_PER_E7, Origin
from autopilot.core.params import ParamSet

_PER_DEG = round(1.0 / DEG_PER_E7)


def shortest_decimal(value: float) -> float:
    """The shortest decimal number that is this float32: 0.3 and not 0.30000001192092896."""
    if not math.isfinite(value):
        return value
    wire = struct.pack("<f", value)
    for digits in range(6, 9):
        short = float(f"{value:.{digits}g}")
        if abs(short) < 3.4e38 and struct.pack("<f", short) == wire:
            return short
    return value


def params_origin(params: Mapping[str, float]) -> Origin:
    """The local origin that parameters give."""
    return Origin(
        lat_deg=_whole_deg(params, "ORIGIN_LAT"),
        lon_deg=_whole_deg(params, "ORIGIN_LON"),
        alt_m=params["ORIGIN_ALT"],
    )


def set_origin_deg(params: ParamSet, name: str, deg: float) -> None:
    """Set ORIGIN_LAT or ORIGIN_LON (``name``) and its rest to ``deg``, to 1e-7 degrees. ConfigError out of range."""
    params.spec(name)
    (wire,) = struct.unpack("<f", struct.pack("<f", deg)) if abs(deg) < 1e9 else (deg,)
    rounded = shortest_decimal(wire)
    params.set(name, rounded)
    params.set(f"{name}_REST", round((deg - rounded) * _PER_DEG))


def _whole_deg(params: Mapping[str, float], name: str) -> float:
    rest = params[f"{name}_REST"]
    return round(params[name] + rest * DEG_PER_E7, 7) if rest else params[name]
