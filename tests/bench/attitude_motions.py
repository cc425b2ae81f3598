"""Made-up motions of raw inertial sensors with their true attitude, for the attitude filter's benchmark.

Every motion is drawn from its family by a seed: how the device turns and is pushed about, what its sensors get wrong,
and what iron and magnets do to the field. All true signals are smooth functions with known derivatives, so gyros and
accelerometers agree with the attitude exactly before errors are added.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.estimator.inertial import GRAVITY_M_S2

RATE_HZ = 100.0
DURATION_S = 120.0
SETTLED_S = 10.0
"""From here on errors count."""
WALL_M = 1.3
"""Half the width of the pool whose walls are of steel."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Recording:
    """Raw sensors and the true attitude."""

    name: str
    rate_hz: float
    """Of gyros and accelerometers."""
    rate_frd_rad_s: FloatArray
    """(n, 3)"""
    accel_frd_m_s2: FloatArray
    """(n, 3) specific force."""
    mag_frd: FloatArray
    """(about n / mag_every, 3) in any unit, with the first sample of every ``mag_every``."""
    mag_every: int
    true: FloatArray
    """(about n / true_every, 3, 3) rotation to NED (north magnetic), with the first sample of every ``true_every``; NaN
    = not known."""
    true_every: int
    counts: NDArray[np.bool_]
    """(len(true),) whether errors there count."""


@dataclass(frozen=True, slots=True, eq=False)
class _Signal:
    """A smooth function of time and its derivative, (n,) each."""

    value: FloatArray
    slope: FloatArray

    def __add__(self, other: "_Signal") -> "_Signal":
        return _Signal(self.value + other.value, self.slope + other.slope)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Motion:
    """How the device moves: angles [rad], velocity over ground [m/s] and acceleration [m/s2] NED, thrust as a share."""

    roll: _Signal
    pitch: _Signal
    yaw: _Signal
    velocity: FloatArray
    acceleration: FloatArray
    thrust: FloatArray


Field = Callable[[np.random.Generator, FloatArray, _Motion, FloatArray], tuple[FloatArray, FloatArray]]
"""(random numbers, times, way, positions) -> disturbance of the field (n, 3) in NED and (n, 3) in body axes, as shares
of the earth's field."""


def record(family: str, seed: int, duration_s: float = DURATION_S) -> Recording:
    """One motion of a family (:data:`FAMILIES`)."""
    move, disturb = FAMILIES[family]
    rng = np.random.default_rng((seed, list(FAMILIES).index(family)))
    t_s = np.arange(1, round(duration_s * RATE_HZ) + 1) / RATE_HZ
    motion = move(rng, t_s)
    position = np.cumsum(motion.velocity, axis=0) / RATE_HZ
    to_ned = rotations(np.column_stack([motion.roll.value, motion.pitch.value, motion.yaw.value]))
    dip = rng.uniform(math.radians(40.0), math.radians(75.0))
    outside, inside = disturb(rng, t_s, motion, position)
    field = np.array([math.cos(dip), 0.0, math.sin(dip)]) + outside
    force = motion.acceleration - np.array([0.0, 0.0, GRAVITY_M_S2])
    measured = _measured(rng, _body_rates(motion), _to_body(to_ned, force))
    magnet = _to_body(to_ned, field) + inside + rng.normal(0.0, 0.02, 3) + rng.normal(0.0, 0.005, field.shape)
    return Recording(
        name=f"{family}, seed {seed}",
        rate_hz=RATE_HZ,
        rate_frd_rad_s=measured[0],
        accel_frd_m_s2=measured[1],
        mag_frd=rng.uniform(0.5, 60.0) * magnet,
        mag_every=1,
        true=to_ned[::5],
        true_every=5,
        counts=(t_s >= SETTLED_S)[::5],
    )


def rotations(rpy_rad: FloatArray) -> FloatArray:
    """(n, 3, 3) body to NED, of (n, 3) roll, pitch, yaw."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy_rad).T, np.sin(rpy_rad).T
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    result: FloatArray = np.array(rows).transpose(2, 0, 1)
    return result


def _to_body(to_ned: FloatArray, vectors: FloatArray) -> FloatArray:
    result: FloatArray = np.einsum("nji,nj->ni", to_ned, vectors)
    return result


def _body_rates(motion: _Motion) -> FloatArray:
    """(n, 3) of the Euler angles' derivatives (Fossen 2011, section 2.2.1)."""
    sr, cr = np.sin(motion.roll.value), np.cos(motion.roll.value)
    sp, cp = np.sin(motion.pitch.value), np.cos(motion.pitch.value)
    p = motion.roll.slope - sp * motion.yaw.slope
    q = cr * motion.pitch.slope + sr * cp * motion.yaw.slope
    r = -sr * motion.pitch.slope + cr * cp * motion.yaw.slope
    return np.column_stack([p, q, r])


def _measured(rng: np.random.Generator, rate: FloatArray, force: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What cheap gyros and accelerometers make of it: bias that walks, scale, noise."""
    walk = np.cumsum(rng.normal(0.0, math.radians(0.003) / math.sqrt(RATE_HZ), rate.shape), axis=0)
    bias = rng.normal(0.0, math.radians(0.3), 3) + walk
    gyros = rate * (1.0 + rng.normal(0.0, 0.002, 3)) + bias + rng.normal(0.0, math.radians(0.1), rate.shape)
    off = rng.normal(0.0, 0.03, 3)
    return gyros, force * (1.0 + rng.normal(0.0, 0.003, 3)) + off + rng.normal(0.0, 0.03, force.shape)


# How it moves.


def _waves(
    rng: np.random.Generator, t_s: FloatArray, size: float, periods_s: tuple[float, float], count: int = 3
) -> _Signal:
    """Sinusoids of random phases whose amplitudes add up to ``size``."""
    amplitudes = rng.dirichlet(np.ones(count)) * size
    omega = 2.0 * math.pi / rng.uniform(*periods_s, count)
    phase = rng.uniform(0.0, 2.0 * math.pi, count)
    angle = omega[:, None] * t_s + phase[:, None]
    return _Signal(amplitudes @ np.sin(angle), (amplitudes * omega) @ np.cos(angle))


def _steps(rng: np.random.Generator, t_s: FloatArray, sizes: FloatArray, every_s: float, rise_s: float) -> _Signal:
    """Smooth steps one after the other at random times, ``every_s`` apart on average."""
    value, slope = np.zeros_like(t_s), np.zeros_like(t_s)
    for n, size in enumerate(sizes):
        x = (t_s - (n + rng.uniform(0.2, 0.8)) * every_s) / (0.25 * rise_s)
        value += 0.5 * size * (1.0 + np.tanh(x))
        slope += 0.5 * size / np.cosh(np.clip(x, -300.0, 300.0)) ** 2 / (0.25 * rise_s)
    return _Signal(value, slope)


def _cruise(yaw: _Signal, ahead: _Signal) -> tuple[FloatArray, FloatArray]:
    """Velocity and acceleration of a vehicle that goes where it points: the acceleration of turning included."""
    c, s = np.cos(yaw.value), np.sin(yaw.value)
    nothing = np.zeros_like(c)
    velocity = np.column_stack([ahead.value * c, ahead.value * s, nothing])
    side = ahead.value * yaw.slope
    return velocity, np.column_stack([ahead.slope * c - side * s, ahead.slope * s + side * c, nothing])


def _tour(rng: np.random.Generator, t_s: FloatArray, sea: float = 0.0) -> _Motion:
    """Legs at some speed with turns between them, on the spot or under way; ``sea`` m/s2 of swell."""
    yaw = _steps(rng, t_s, rng.uniform(-2.0, 2.0, 9), DURATION_S / 9, rng.uniform(2.0, 6.0))
    yaw += _Signal(np.full_like(t_s, rng.uniform(-3.0, 3.0)), np.zeros_like(t_s))
    speeds = rng.uniform(-0.2, 0.6, 12)
    ahead = _steps(rng, t_s, np.diff(speeds, prepend=0.0), DURATION_S / 12, rng.uniform(1.0, 3.0))
    velocity, acceleration = _cruise(yaw, ahead)
    swell = [_waves(rng, t_s, sea * rng.uniform(0.3, 1.0), (2.5, 8.0)) for _ in range(3)]
    tilt_rad = math.radians(rng.uniform(1.0, 4.0) + 6.0 * sea)
    return _Motion(
        roll=_waves(rng, t_s, tilt_rad, (1.5, 8.0)),
        pitch=_waves(rng, t_s, tilt_rad, (1.5, 8.0)),
        yaw=yaw + _waves(rng, t_s, 0.5 * tilt_rad, (2.0, 10.0)),
        velocity=velocity,
        acceleration=acceleration + np.column_stack([each.value for each in swell]),
        thrust=ahead.value / 0.6 + ahead.slope,
    )


def _swell(rng: np.random.Generator, t_s: FloatArray) -> _Motion:
    return _tour(rng, t_s, rng.uniform(0.5, 1.5))


def _circles(rng: np.random.Generator, t_s: FloatArray) -> _Motion:
    """Round and round at one speed: in body axes the acceleration never changes."""
    turn = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.8)
    tilt_rad = math.radians(2.0)
    yaw = _Signal(turn * t_s, np.full_like(t_s, turn))
    ahead = _Signal(np.full_like(t_s, rng.uniform(0.3, 0.8)), np.zeros_like(t_s))
    velocity, acceleration = _cruise(yaw, ahead)
    return _Motion(
        roll=_waves(rng, t_s, tilt_rad, (1.5, 8.0)),
        pitch=_waves(rng, t_s, tilt_rad, (1.5, 8.0)),
        yaw=yaw,
        velocity=velocity,
        acceleration=acceleration,
        thrust=ahead.value / 0.6,
    )


def _hovering(rng: np.random.Generator, t_s: FloatArray) -> _Motion:
    """Nearly still, turning at a degree per second or so all the time: not a device at rest."""
    turn = rng.choice([-1.0, 1.0]) * math.radians(rng.uniform(0.5, 2.0))
    nothing = np.zeros((len(t_s), 3))
    tilt_rad = math.radians(0.3)
    return _Motion(
        roll=_waves(rng, t_s, tilt_rad, (4.0, 12.0)),
        pitch=_waves(rng, t_s, tilt_rad, (4.0, 12.0)),
        yaw=_Signal(turn * t_s, np.full_like(t_s, turn)),
        velocity=nothing,
        acceleration=nothing + np.column_stack([_waves(rng, t_s, 0.05, (3.0, 8.0)).value for _ in range(3)]),
        thrust=np.zeros_like(t_s),
    )


def _handled(rng: np.random.Generator, t_s: FloatArray) -> _Motion:
    """Swung about by hand: large angles, accelerations of some m/s2."""
    periods_s = (rng.uniform(0.7, 1.5), rng.uniform(3.0, 6.0))
    push = rng.uniform(1.0, 5.0)
    pushes = [_waves(rng, t_s, push * rng.uniform(0.3, 1.0), periods_s, 5) for _ in range(3)]
    tilt_rad = math.radians(rng.uniform(10.0, 50.0))
    return _Motion(
        roll=_waves(rng, t_s, tilt_rad, (2.0, 6.0)),
        pitch=_waves(rng, t_s, tilt_rad, (2.0, 6.0)),
        yaw=_waves(rng, t_s, 2.0, (4.0, 20.0)),
        velocity=np.zeros((len(t_s), 3)),
        acceleration=np.column_stack([each.value for each in pushes]),
        thrust=np.zeros_like(t_s),
    )


# What disturbs the field.


def _clean(
    rng: np.random.Generator, t_s: FloatArray, motion: _Motion, position: FloatArray
) -> tuple[FloatArray, FloatArray]:
    return np.zeros_like(position), np.zeros_like(position)


def _steel_walls(
    rng: np.random.Generator, t_s: FloatArray, motion: _Motion, position: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Another field at every place, more of it beside the walls."""
    place = WALL_M * np.sin(position / WALL_M)
    outside = np.zeros_like(position)
    for _ in range(8):
        pole = rng.uniform(-1.0, 1.0, 3) * [1.6 * WALL_M, 1.6 * WALL_M, 1.0] + [0.0, 0.0, 0.8]
        away = place - pole
        outside += rng.normal(0.0, 0.1, 3) / (0.3 + (away**2).sum(axis=1, keepdims=True))
    return outside, np.zeros_like(position)


def _passing_magnet(
    rng: np.random.Generator, t_s: FloatArray, motion: _Motion, position: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Something magnetic beside the vehicle for a while, twice."""
    outside = np.zeros_like(position)
    for begin_s in (rng.uniform(20.0, 40.0), rng.uniform(75.0, 85.0)):
        end_s = begin_s + rng.uniform(5.0, 25.0)
        near = 0.5 * (np.tanh((t_s - begin_s) / 0.5) - np.tanh((t_s - end_s) / 0.5))
        outside += near[:, None] * rng.normal(0.0, 0.6, 3)
    return outside, np.zeros_like(position)


def _attached_magnet(
    rng: np.random.Generator, t_s: FloatArray, motion: _Motion, position: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Iron that turns with the device, from the start on."""
    towards = rng.normal(size=3)
    return np.zeros_like(position), np.tile(rng.uniform(0.1, 0.3) * towards / np.linalg.norm(towards), (len(t_s), 1))


def _motors(
    rng: np.random.Generator, t_s: FloatArray, motion: _Motion, position: FloatArray
) -> tuple[FloatArray, FloatArray]:
    return np.zeros_like(position), motion.thrust[:, None] * rng.normal(0.0, 0.15, 3)


FAMILIES: Mapping[str, tuple[Callable[[np.random.Generator, FloatArray], _Motion], Field]] = {
    "tour": (_tour, _clean),
    "swell": (_swell, _clean),
    "circles": (_circles, _clean),
    "hovering": (_hovering, _clean),
    "handled": (_handled, _clean),
    "steel walls": (_tour, _steel_walls),
    "passing magnet": (_tour, _passing_magnet),
    "passing magnet, swell": (_swell, _passing_magnet),
    "attached magnet": (_handled, _attached_magnet),
    "motors": (_tour, _motors),
}
"""Name -> how it moves, what disturbs the field."""
