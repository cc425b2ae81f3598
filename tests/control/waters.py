"""Machine-made waters, ways through them, and estimates that lag and err as the real ones do: what forecasts of the
current are judged with."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from autopilot.control.current.currents import CurrentForecast
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence, Polygon
from autopilot.sitl.current_fields import STILL, Bickley, CurrentField, Gyre, Shear, TankJet
from tests.control.control_loop import nav_state

STEP_S = 0.2
AHEAD_S = 8.0
ESTIMATE_LAG_S, NOISE_M_S, NOISE_S, BIAS_M_S = 1.2, 0.02, 2.0, 0.01
"""Estimates follow the water with the lag and carry noise that lasts, and what the model lacks."""

KINDS = ("uniform", "turning", "jet and return", "jet", "gyre", "shear", "still")

Water = Callable[[FloatArray, float], FloatArray]
"""Place (2,) and time -> current (2,)."""


@dataclass(frozen=True)
class World:
    """A fenced room with its water, and a flight through it."""

    fence: Fence
    pos: FloatArray
    leg: FloatArray
    truth: FloatArray
    estimated: FloatArray


def room(length_m: float, width_m: float) -> Fence:
    x, y = 0.5 * length_m, 0.5 * width_m
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return Fence(inclusions=(Polygon(vertices_ned_m=corners),), exclusions=(), depth_min_m=0.0, depth_max_m=5.0)


def water_of(kind: str, rng: np.random.Generator, length_m: float, width_m: float) -> Water:
    speed, angle = rng.uniform(0.1, 0.35), rng.uniform(0.0, 2.0 * math.pi)
    turn = 2.0 * math.pi / rng.uniform(200.0, 900.0) * rng.choice([-1.0, 1.0]) if kind == "turning" else 0.0
    if kind in ("uniform", "turning"):
        return lambda _, t: speed * np.array([math.cos(angle + turn * t), math.sin(angle + turn * t)])
    fields: dict[str, CurrentField] = {
        "jet and return": TankJet(speed_m_s=speed, length_m=length_m, width_m=width_m),
        "jet": Bickley(
            speed_m_s=speed, width_m=width_m * rng.uniform(0.08, 0.25), center_y_m=rng.uniform(-0.3, 0.3) * width_m
        ),
        "gyre": Gyre(speed_m_s=speed, cell_m=width_m * rng.uniform(0.4, 1.0)),
        "shear": Shear(shear_1_s=speed / width_m * rng.uniform(0.5, 2.0), speed_m_s=rng.uniform(-0.2, 0.2)),
        "still": STILL,
    }
    field = fields[kind]
    return lambda pos, t: np.array(field.velocity((float(pos[0]), float(pos[1]), 0.5), t)[:2])


def world_of(kind: str, seed: int, legs: int = 4, limit_s: float = 300.0) -> World:
    """A room of 3 to 60 m and a mission of three waypoints, flown straight at up to 0.45 m/s through the water."""
    rng = np.random.default_rng(seed)
    width = math.exp(rng.uniform(math.log(3.0), math.log(60.0)))
    length = width * rng.uniform(1.0, 2.0)
    water = water_of(kind, rng, length, width)
    places = [rng.uniform(-0.38, 0.38, 2) * [length, width] for _ in range(3)]
    pos, leg, here = [], [], places[0].copy()
    for k in range(1, legs + 1):
        goal = places[k % 3]
        while float(np.hypot(*(goal - here))) > 0.1 and len(pos) * STEP_S < limit_s:
            c, direction = water(here, len(pos) * STEP_S), (goal - here) / np.hypot(*(goal - here))
            along = float(c @ direction)
            speed = along + math.sqrt(max(0.0, along**2 - float(c @ c) + 0.45**2))
            here = here + direction * max(0.08, min(0.35, speed)) * STEP_S
            pos.append(here)
            leg.append(k)
    truth = np.array([water(p, i * STEP_S) for i, p in enumerate(pos)])
    estimated, lagging, noise = np.zeros((len(pos), 3)), truth[0].copy(), rng.normal(size=2) * NOISE_M_S
    bias, fade = rng.normal(size=2) * BIAS_M_S, math.exp(-STEP_S / NOISE_S)
    for i, seen in enumerate(truth):
        lagging += (seen - lagging) * STEP_S / ESTIMATE_LAG_S
        noise = fade * noise + NOISE_M_S * math.sqrt(1.0 - fade**2) * rng.normal(size=2)
        estimated[i, :2] = lagging + noise + bias
    return World(fence=room(length, width), pos=np.array(pos), leg=np.array(leg), truth=truth, estimated=estimated)


def errors_of(world: World, forecasts: Mapping[str, CurrentForecast]) -> dict[str, tuple[float, float]]:
    """Mean error of each forecast [m/s] over the next 8 s and the rest of the leg, along the way that was flown."""
    found: dict[str, tuple[float, float]] = {}
    n = len(world.pos)
    last = np.array([int(np.flatnonzero(world.leg == k)[-1]) for k in world.leg])
    for name, forecast in forecasts.items():
        forecast.within(world.fence)
        errors = []
        for i in range(n):
            state = np.array([*world.pos[i], 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
            nav = nav_state(round(i * STEP_S * 1e6), state, world.estimated[i])
            forecast.view(nav)
            if i % 8 or i >= n - 2:
                continue
            row = []
            for end in (min(n - 1, i + round(AHEAD_S / STEP_S)), max(int(last[i]), i + 1)):
                at = np.unique(np.linspace(i, end, 10).astype(int))
                out = np.empty((len(at), 3))
                forecast.fill(nav, np.column_stack([world.pos[at], np.full(len(at), 0.5)]), (at - i) * STEP_S, out)
                row.append(float(np.hypot(*(out[:, :2] - world.truth[at]).T).mean()))
            errors.append(row)
        near, far = np.mean(errors, axis=0)
        found[name] = (float(near), float(far))
    return found
