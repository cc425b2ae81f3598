"""Random currents as scenario tables, and their evaluation at many points."""

import math
from typing import Any

import numpy as np

from autopilot.campaign.worlds.distance_map import Flow
from autopilot.core.frames import FloatArray
from autopilot.sitl.current_fields import Current, CurrentField, Uniform, current_field

STEEPEST_1_S = 0.6
"""Maximum velocity gradient [1/s]; the jet of the paper's tank has 0.52."""
PHASES = 8
"""Sample times within a tidal period."""


def draw_current(
    rng: np.random.Generator, kind: str, size_m: tuple[float, float], middle: tuple[float, float], limit_m_s: float
) -> dict[str, Any]:
    """``[current]`` of a world of this size and centre, for a vehicle with the maximum speed ``limit_m_s``."""
    table = _drawn(rng, kind, size_m, middle, limit_m_s)
    less = min(1.0, STEEPEST_1_S / max(_steepness_1_s(table), 1e-9))
    for key in ("speed_m_s", "shear_1_s", "circulation_m2_s"):
        if key in table:
            table[key] = round(table[key] * less, 4)
    return table


def _steepness_1_s(table: dict[str, Any]) -> float:
    """Largest change of the water's speed over a metre."""
    speed = abs(float(table.get("speed_m_s", 0.0)))
    match table["kind"]:
        case "jet":
            return 2.0 * math.pi * speed / float(table["width_m"])
        case "gyre":
            return math.pi * speed / float(table["cell_m"])
        case "vortex":
            # In its middle it turns as a whole.
            return abs(float(table["circulation_m2_s"])) / (2.0 * math.pi * float(table["core_m"]) ** 2)
        case "shear":
            return abs(float(table["shear_1_s"]))
        case "bickley":
            return 0.77 * speed / float(table["width_m"])
        case _:
            return 0.0


def _drawn(
    rng: np.random.Generator, kind: str, size_m: tuple[float, float], middle: tuple[float, float], limit_m_s: float
) -> dict[str, Any]:
    what = rng.choice(["none", "uniform", "tide", "jet", "gyre", "vortex", "shear", "bickley"], p=_WEIGHTS)
    speed = round(limit_m_s * _speed_ratio(rng, closed=kind != "open"), 3)
    angle = rng.uniform(-math.pi, math.pi)
    flow = [round(speed * math.cos(angle), 3), round(speed * math.sin(angle), 3), 0.0]
    match what:
        case "none":
            return {"kind": "none"}
        case "uniform":
            return {"kind": "uniform", "velocity_m_s": flow}
        case "tide":
            # Turns by up to 45 degrees either way, or varies in strength.
            swing = rng.uniform(-0.5, 0.5)
            side = angle + float(rng.choice([0.0, 0.5 * math.pi]))
            tide = [round(swing * speed * math.cos(side), 3), round(swing * speed * math.sin(side), 3), 0.0]
            slack = [round(each / (1.0 + abs(swing)), 3) for each in flow]
            period = round(rng.uniform(150.0, 900.0), 0)
            return {"kind": "uniform", "velocity_m_s": slack, "tide_m_s": tide, "tide_period_s": period}
        case "jet":
            turned = 0.0 if kind in ("tank", "pool") else round(angle, 2)
            length, width = size_m if kind in ("tank", "pool") else (rng.uniform(15.0, 50.0), rng.uniform(8.0, 30.0))
            return {
                "kind": "jet",
                "speed_m_s": speed if rng.random() < 0.5 else -speed,
                "center_m": [round(each, 2) for each in middle],
                "length_m": round(float(length), 2),
                "width_m": round(float(width), 2),
                "direction_rad": turned,
            }
        case "gyre":
            return {"kind": "gyre", "speed_m_s": speed, "cell_m": round(rng.uniform(0.5, 1.5) * min(*size_m, 40.0), 2)}
        case "vortex":
            core = round(rng.uniform(0.1, 0.3) * min(*size_m, 40.0), 2)
            place = [round(m + rng.uniform(-0.3, 0.3) * min(s, 40.0), 2) for m, s in zip(middle, size_m, strict=True)]
            # The largest speed of a Lamb-Oseen vortex is 0.6382 circulation / (2 pi core).
            turning = round(speed * 2.0 * math.pi * core / 0.6382 * float(rng.choice([-1.0, 1.0])), 4)
            return {"kind": "vortex", "center_m": place, "circulation_m2_s": turning, "core_m": core}
        case "shear":
            reach = 0.5 * min(size_m[1], 40.0)
            return {"kind": "shear", "shear_1_s": round(speed / reach, 4), "center_y_m": round(middle[1], 2)}
        case _:
            width = round(rng.uniform(0.15, 0.4) * min(size_m[1], 40.0), 2)
            return {"kind": "bickley", "speed_m_s": speed, "width_m": width, "center_y_m": round(middle[1], 2)}


_WEIGHTS = (0.22, 0.2, 0.1, 0.18, 0.14, 0.06, 0.05, 0.05)


def _speed_ratio(rng: np.random.Generator, *, closed: bool) -> float:
    """Current speed over the vehicle's speed: mostly well below 1, sometimes near, rarely beyond."""
    sort = rng.random()
    if sort < 0.55:
        return float(rng.uniform(0.1, 0.6))
    if sort < 0.8:
        return float(rng.uniform(0.6, 0.85))
    return float(rng.uniform(0.85, 1.05 if closed else 1.4))


def flow_of(table: Current) -> Flow:
    """The water of a scenario for a chart."""
    field = current_field(table)
    times = _times(field)

    def flow(places: FloatArray) -> FloatArray:
        if field.steady_uniform:
            still = np.array(field.velocity((0.0, 0.0, 0.0), 0.0)[:2])
            return np.broadcast_to(still, (1, len(places), 2))
        if isinstance(field, Uniform):
            phases = np.array([field.velocity((0.0, 0.0, 0.0), t_s)[:2] for t_s in times])
            return np.broadcast_to(phases[:, None, :], (len(times), len(places), 2))
        return np.array([[field.velocity((north, east, 0.0), 0.0)[:2] for north, east in places.tolist()]])

    return flow


def _times(field: CurrentField) -> list[float]:
    if isinstance(field, Uniform) and not field.steady_uniform:
        return [field.tide_period_s * phase / PHASES for phase in range(PHASES)]
    return [0.0]
