"""A light truth simulator for estimator tests: 4-DoF motion through a current, AHRS and pose samples with faults.

Written on its own (Fossen 2011, surge, sway, heave, yaw with added mass and a current that varies in space), shares no
equations with the estimators.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd, rpy_from_r, wrap_pi
from autopilot.core.messages import NavState
from autopilot.core.samples import AhrsSample, LaserSample, PoseSample, Sample
from autopilot.estimator.protocol import Estimator

G = 9.81
TICK_US = 10_000
FLOOR_M = 1.5

CurrentField = Callable[[float, float], tuple[float, float]]


def no_current(n: float, e: float) -> tuple[float, float]:
    return 0.0, 0.0


def uniform_current(n: float, e: float) -> tuple[float, float]:
    return 0.12, -0.06


def tank_jet(n: float, e: float) -> tuple[float, float]:
    """Jet along north in the middle of a 5 m x 3 m tank with return flow, 0.25 m/s at most."""
    xi = min(1.0, max(0.0, (n + 2.5) / 5.0))
    phase = 2.0 * math.pi * (e + 1.5) / 3.0
    h = 6.75 * xi * (1.0 - xi) ** 2
    slope = 6.75 * (1.0 - xi) * (1.0 - 3.0 * xi) / 5.0
    return -0.25 * math.cos(phase) * h, 0.25 * 3.0 / (2.0 * math.pi) * math.sin(phase) * slope


@dataclass
class Truth:
    """What is so, at one tick."""

    t_us: int
    pos: FloatArray
    yaw: float
    vel: FloatArray
    vel_water_frd: FloatArray
    current: FloatArray
    rate: float


@dataclass
class Faults:
    """How the world differs from the ideal."""

    seed: int = 1
    pos_sigma: float = 0.003
    yaw_sigma: float = math.radians(0.15)
    latency_us: int = 60_000
    jitter_us: int = 0
    ahrs_latency_us: int = 15_000
    tilt_error: float = math.radians(0.4)
    yaw_offset: float = math.radians(3.0)
    yaw_offset_swing: float = math.radians(2.0)
    gyro_bias: float = 0.01
    accel_bias: float = 0.04
    outliers: float = 0.0
    mass_factor: float = 1.0
    drag_factor: float = 1.0
    tether_n: float = 0.0
    vision_gap_s: tuple[float, float] = (1e9, 1e9)
    ahrs_stuck_s: tuple[float, float] = (1e9, 1e9)
    ahrs_gap_s: tuple[float, float] = (1e9, 1e9)
    shift_s: float = 1e9
    shift_m: FloatArray = field(default_factory=lambda: np.array([0.5, 0.0, 0.0]))
    laser: bool = False
    vision: bool = True


class World:
    """Vehicle, water and sensors. Iterate over ticks: truth, samples that arrive now, thrust of the last tick."""

    M = (16.5, 22.0, 22.5, 0.30)
    RIGID = 12.0
    LIN = (4.0, 6.0, 6.0, 0.3)
    QUAD = (30.0, 55.0, 60.0, 1.2)
    TAU = 0.15

    def __init__(self, current: CurrentField, faults: Faults | None = None, start: tuple[float, ...] = (-1.6, -0.35)):
        self.f = faults or Faults()
        self.rng = np.random.default_rng(self.f.seed)
        self.current = current
        self.n, self.e, self.d, self.yaw = start[0], start[1], 0.45, 0.0
        self.u = self.v = self.w = self.r = 0.0  # body velocities over ground
        self.thrust = np.zeros(4)
        self.t_us = 0
        self.tilt = self.rng.normal(0.0, self.f.tilt_error, 2)
        self.accel_bias = self.rng.normal(0.0, self.f.accel_bias, 3)
        self.gyro_bias = self.rng.normal(0.0, self.f.gyro_bias)
        self.pending: list[tuple[int, Sample]] = []
        self.goals = [(1.75, 0.0, 0.30, math.pi), (-1.6, -0.35, 0.45, 0.0)]
        self.goal = 0
        self.accel = np.zeros(3)
        self.wobble_phase = self.rng.uniform(0.0, 6.0, 2)

    def run(self, seconds: float) -> Iterator[tuple[Truth, list[Sample], FloatArray]]:
        for _ in range(round(seconds * 100)):
            command = self._command()
            for _ in range(2):
                self._move(command, 0.005)
            self.t_us += TICK_US
            self._sense()
            now = [s for due, s in self.pending if due <= self.t_us]
            self.pending = [(due, s) for due, s in self.pending if due > self.t_us]
            yield self.truth(), now, command

    def truth(self) -> Truth:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        cn, ce = self.current(self.n, self.e)
        vn, ve = c * self.u - s * self.v, s * self.u + c * self.v
        rel = (c * (vn - cn) + s * (ve - ce), c * (ve - ce) - s * (vn - cn), self.w)
        return Truth(
            self.t_us,
            np.array([self.n, self.e, self.d]),
            self.yaw,
            np.array([vn, ve, self.w]),
            np.array(rel),
            np.array([cn, ce, 0.0]),
            self.r,
        )

    def _command(self) -> FloatArray:
        """A simple pilot who knows the truth: carrot ahead, speed loop on water-relative velocity."""
        gn, ge, gd, gyaw = self.goals[self.goal]
        dn, de = gn - self.n, ge - self.e
        # A bulge in the path makes it cross the jet.
        bulge = 0.6 * math.sin(math.pi * (self.n + 1.6) / 3.35) * (1.0 if self.goal == 0 else -1.0)
        de += bulge
        distance = math.hypot(dn, de)
        if math.hypot(gn - self.n, ge - self.e) < 0.2 and abs(wrap_pi(gyaw - self.yaw)) < 0.15:
            self.goal = 1 - self.goal
        speed = min(0.4, 0.8 * distance)
        tn, te = speed * dn / max(distance, 1e-6), speed * de / max(distance, 1e-6)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        want_u, want_v = c * tn + s * te, c * te - s * tn
        x = 40.0 * (want_u - self.u) + 6.0 * want_u
        y = 40.0 * (want_v - self.v) + 6.0 * want_v
        z = 40.0 * (max(-0.2, min(0.2, gd - self.d)) - self.w) + 0.6
        n = 2.0 * (max(-0.8, min(0.8, wrap_pi(gyaw - self.yaw))) - self.r)
        turn = n / 0.24
        return np.clip(np.array([0.5 * x + turn, 0.5 * x - turn, z, y]), -12.0, 12.0)

    def _move(self, command: FloatArray, dt: float) -> None:
        f = self.f
        self.thrust = self.thrust + (command - self.thrust) * (1.0 - math.exp(-dt / self.TAU))
        p, s_, ve_, la = self.thrust.tolist()
        m = [a * f.mass_factor for a in self.M]
        rigid = self.RIGID * f.mass_factor
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        vn, ve = c * self.u - s * self.v, s * self.u + c * self.v
        cn, ce = self.current(self.n, self.e)
        h = 0.5 * dt
        c2n, c2e = self.current(self.n + vn * h, self.e + ve * h)
        c1n, c1e = self.current(self.n - vn * h, self.e - ve * h)
        gn, ge = (c2n - c1n) / dt, (c2e - c1e) / dt  # change of the current along the way
        cu, cv = c * cn + s * ce, c * ce - s * cn
        gu, gv = c * gn + s * ge, c * ge - s * gn
        ur, vr = self.u - cu, self.v - cv
        r = self.r

        def drag(i: int, a: float) -> float:
            return f.drag_factor * (self.LIN[i] + self.QUAD[i] * abs(a)) * a

        # Rigid body: m (u' - v r), added mass on the relative velocity: A (ur' - ...), ur' = u' - (gu + r cv)
        au, av = m[0] - rigid, m[1] - rigid
        fx = p + s_ - drag(0, ur) + rigid * self.v * r + au * (gu + r * cv) + av * vr * r - f.tether_n
        fy = la - drag(1, vr) - rigid * self.u * r + av * (gv - r * cu) - au * ur * r
        fz = ve_ - drag(2, self.w) - 0.6
        fr = 0.12 * (p - s_) + 0.02 * la - drag(3, r) + (m[0] - m[1]) * ur * vr
        du, dv, dw, dr = fx / m[0], fy / m[1], fz / m[2], fr / m[3]
        self.accel = np.array([du - self.v * r, dv + self.u * r, dw])
        self.u, self.v, self.w, self.r = self.u + du * dt, self.v + dv * dt, self.w + dw * dt, r + dr * dt
        c, s = math.cos(self.yaw + 0.5 * self.r * dt), math.sin(self.yaw + 0.5 * self.r * dt)
        self.n += (c * self.u - s * self.v) * dt
        self.e += (s * self.u + c * self.v) * dt
        self.d += self.w * dt
        self.yaw += self.r * dt

    def tilt_angles(self) -> tuple[float, float]:
        """Roll and pitch: a wobble of one degree."""
        t = 1e-6 * self.t_us
        a = math.radians(1.0)
        return a * math.sin(1.7 * t + self.wobble_phase[0]), a * math.sin(1.3 * t + self.wobble_phase[1])

    def ahrs(self) -> AhrsSample:
        f, rng, t = self.f, self.rng, 1e-6 * self.t_us
        roll, pitch = self.tilt_angles()
        a = math.radians(1.0)
        roll_rate = a * 1.7 * math.cos(1.7 * t + self.wobble_phase[0])
        pitch_rate = a * 1.3 * math.cos(1.3 * t + self.wobble_phase[1])
        k = math.exp(-0.01 / 20.0)
        self.tilt = k * self.tilt + math.sqrt(1.0 - k * k) * rng.normal(0.0, f.tilt_error, 2)
        r_level = r_ned_from_frd(np.array([roll, pitch, 0.0]))
        force = r_level.T @ (self.accel - np.array([0.0, 0.0, G])) + self.accel_bias + rng.normal(0.0, 0.02, 3)
        offset = f.yaw_offset + f.yaw_offset_swing * math.sin(2.0 * self.n)
        yaw = wrap_pi(self.yaw + offset + rng.normal(0.0, math.radians(0.3)))
        return AhrsSample(
            t_us=self.t_us,
            rpy_rad=np.array([roll + self.tilt[0], pitch + self.tilt[1], yaw]),
            rate_frd_rad_s=np.array([roll_rate, pitch_rate, self.r + self.gyro_bias]) + rng.normal(0.0, 0.003, 3),
            accel_frd_m_s2=force,
        )

    def _sense(self) -> None:
        f, t = self.f, 1e-6 * self.t_us
        sample = self.ahrs()
        if f.ahrs_stuck_s[0] <= t < f.ahrs_stuck_s[1]:
            last = getattr(self, "_stuck", sample)
            self._stuck = last
            sample = AhrsSample(
                t_us=self.t_us,
                rpy_rad=last.rpy_rad,
                rate_frd_rad_s=last.rate_frd_rad_s,
                accel_frd_m_s2=last.accel_frd_m_s2,
            )
        if not f.ahrs_gap_s[0] <= t < f.ahrs_gap_s[1]:
            self.pending.append((self.t_us + f.ahrs_latency_us, sample))
        tick = self.t_us // TICK_US
        if f.vision and (tick * 3) % 10 < 3 and not f.vision_gap_s[0] <= t < f.vision_gap_s[1]:
            self._look(t)

    def _look(self, t: float) -> None:
        f, rng = self.f, self.rng
        pos = np.array([self.n, self.e, self.d]) + rng.normal(0.0, f.pos_sigma, 3)
        yaw = self.yaw + rng.normal(0.0, f.yaw_sigma)
        if rng.random() < f.outliers:
            pos = pos + rng.uniform(-1.0, 1.0, 3)
            yaw += rng.uniform(-0.5, 0.5)
        if t >= f.shift_s:
            pos = pos + f.shift_m
        late = f.latency_us + (int(rng.uniform(-f.jitter_us, f.jitter_us)) if f.jitter_us else 0)
        self.pending.append(
            (
                self.t_us + late,
                PoseSample(
                    t_us=self.t_us,
                    pos_ned_m=pos,
                    yaw_rad=wrap_pi(yaw),
                    sigma_pos_m=np.full(3, f.pos_sigma),
                    sigma_yaw_rad=f.yaw_sigma,
                ),
            )
        )
        if f.laser:
            roll, pitch = self.tilt_angles()
            r = r_ned_from_frd(np.array([roll, pitch, 0.0]))
            below = float((r @ np.array([0.0, 0.05, 0.10]))[2])
            height = (FLOOR_M - self.d - below) / (math.cos(roll) * math.cos(pitch)) + rng.normal(0.0, 0.006)
            self.pending.append((self.t_us + late, LaserSample(t_us=self.t_us, range_m=height, sigma_m=0.006)))


@dataclass
class Track:
    """A run: truth and estimates at every tick after the estimator came up."""

    truth: list[Truth]
    nav: list[NavState]
    states: list[object]

    def after(self, t_s: float, until_s: float = 1e9) -> "Track":
        keep = [k for k, n in enumerate(self.nav) if t_s <= 1e-6 * n.t_us < until_s]
        return Track([self.truth[k] for k in keep], [self.nav[k] for k in keep], [])

    def pos_error(self) -> FloatArray:
        return np.array([n.pos_ned_m - t.pos for t, n in zip(self.truth, self.nav, strict=True)])

    def yaw_error(self) -> FloatArray:
        return np.array([wrap_pi(float(n.rpy_rad[2]) - t.yaw) for t, n in zip(self.truth, self.nav, strict=True)])

    def vel_error(self) -> FloatArray:
        return np.array(
            [r_ned_from_frd(n.rpy_rad) @ n.vel_frd_m_s - t.vel for t, n in zip(self.truth, self.nav, strict=True)]
        )

    def water_velocity_error(self) -> FloatArray:
        return np.array([n.vel_water_frd_m_s - t.vel_water_frd for t, n in zip(self.truth, self.nav, strict=True)])

    def current_error(self) -> FloatArray:
        return np.array([n.current_ned_m_s - t.current for t, n in zip(self.truth, self.nav, strict=True)])


def rms(values: FloatArray) -> float:
    """Root mean square over time of the length of each row."""
    values = np.asarray(values)
    return float(np.sqrt(np.mean(np.sum(values.reshape(len(values), -1) ** 2, axis=1))))


def fly(
    estimator: Estimator,
    world: World,
    seconds: float,
    change: Callable[[int, list[Sample]], list[Sample]] | None = None,
) -> Track:
    """Run the world into the estimator; ``change`` may tamper with the samples of a tick."""
    track = Track([], [], [])
    for truth, samples, command in world.run(seconds):
        if change is not None:
            samples = change(truth.t_us, samples)
        nav = estimator.step(truth.t_us, samples, command)
        if nav is not None:
            track.truth.append(truth)
            track.nav.append(nav)
    return track


__all__ = ["Faults", "Track", "Truth", "World", "fly", "no_current", "rms", "rpy_from_r", "tank_jet", "uniform_current"]
