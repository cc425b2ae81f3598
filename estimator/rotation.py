"""Quaternions (w, x, y, z) and vectors as plain floats: at 100 Hz the overhead of numpy would exceed the arithmetic."""

import math

from autopilot.estimator.inertial import cross

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]

IDENTITY: Four = (1.0, 0.0, 0.0, 0.0)


def product(a: Four, b: Four) -> Four:
    """First ``b``, then ``a``; of length 1 up to rounding, however long the chain."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    size = math.sqrt(w * w + x * x + y * y + z * z)
    return w / size, x / size, y / size, z / size


def turned(q: Four, v: Three) -> Three:
    w, x, y, z = q
    a, b, c = v
    i, j, k = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * i + y * k - z * j, b + w * j + z * i - x * k, c + w * k + x * j - y * i


def rotation_by(vector_rad: Three) -> Four:
    """About the vector's direction by its length."""
    x, y, z = vector_rad
    angle = math.sqrt(x * x + y * y + z * z)
    factor = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), factor * x, factor * y, factor * z


def turn_between(before: Three, after: Three, dt_s: float) -> Three:
    """Rotation vector of a body whose rates [rad/s] go evenly from one to the other (Magnus expansion, second term)."""
    cone = dt_s * dt_s / 12.0
    x, y, z = cross(before, after)
    half = 0.5 * dt_s
    return (
        half * (before[0] + after[0]) + cone * x,
        half * (before[1] + after[1]) + cone * y,
        half * (before[2] + after[2]) + cone * z,
    )


def of_tilt(roll: float, pitch: float) -> Four:
    """Body to level, heading 0."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    return cp * cr, cp * sr, sp * cr, -sp * sr


def roll_pitch_yaw(q: Four) -> Three:
    """rad"""
    w, x, y, z = q
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def rows(q: Four) -> tuple[Three, Three, Three]:
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
