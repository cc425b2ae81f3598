"""Estimation of the command latency: a bank of Kalman filters, one per candidate delay.

Candidate k assumes that the thrust commanded k intervals ago acts now. Per axis the 4-DoF model reads (Fossen 2011,
ch. 6, with the thrust split by thruster)

    nu'(t) = M^-1 T_A diag(F(t - delay_k)) e + f(nu) + d ,

F the thrust of the pulses, lag included, f drag, Coriolis and buoyancy, d the disturbance. Both sides pass the same
first-order filter, which avoids differentiation: the filtered nu' is (nu - filtered nu) / T. By linearity the filtered
thrust of a candidate is the filtered thrust of k intervals ago: one history serves all.

Every filter estimates e (errors of mass and thrust constant, thruster faults) and d (current, tether) for its own
delay. The innovations' likelihood with exponential forgetting gives the probability of each delay (multiple model
estimator: Bar-Shalom, Li and Kirubarajan 2001, section 11.6). Without a response so far, all delays longer than the
elapsed time are equally likely: latency is detected first, its value a little later.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from autopilot.control.thrust.thrust_tuning import DISTURBANCE_LEVEL
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import AXES, NO_FORCES, Model4, forced_acceleration
from autopilot.core.params import ParamSet
from autopilot.core.response import Response
from autopilot.core.vehicle import Vehicle

UNLEARNED_LOOKS = 10
"""Updates (1 s) that are reverted when the estimate degrades."""

BESIDES = 5
"""States beside e of every thruster: d of four axes, yaw moment by lateral thrust."""
LONGEST_DOUBT_S = 2.5
"""Without thrust for so long a delay has shown itself; if not, something else is wrong with the thrusters."""


SETTLE_S = 4.0
"""The position estimator needs so long to forget the current that it saw in thrust that had not acted yet."""


def thrustless_motion(model: Model4, nav: NavState, current_ned_m_s: Sequence[float]) -> tuple[float, ...]:
    """(8,) velocity over ground and yaw rate, and their rate of change without thrust in that current (3,).

    Used by :mod:`autopilot.control.thrust.thruster_health` and :mod:`autopilot.control.thrust.actuation_delay`: the
    difference to the measured acceleration is thrust or an unmodelled disturbance."""
    ground_u, ground_v, ground_w = nav.vel_frd_m_s.tolist()
    north, east, down = current_ned_m_s
    yaw, r = nav.rpy_rad.item(2), nav.rate_frd_rad_s.item(2)
    c, s = math.cos(yaw), math.sin(yaw)
    flow_u, flow_v = c * north + s * east, c * east - s * north
    nu = (ground_u - flow_u, ground_v - flow_v, ground_w - down, r)
    du, dv, dw, dr = forced_acceleration(model, nu, NO_FORCES, math)
    # A steady current turns in the body frame.
    return ground_u, ground_v, ground_w, r, du + r * flow_v, dv - r * flow_u, dw, dr


def push_sigma(model: Model4, nav: NavState, at_rest: tuple[float, ...], flow_m_s: float) -> FloatArray:
    """(4,) standard deviation of unknown accelerations at the speed of now.

    ``at_rest`` (4,) is that of a vehicle at rest; ``flow_m_s`` that of the water's velocity, of which drag and Munk
    moment make more the faster the vehicle is."""
    m11, m22, _, m44 = model.mass_kg
    speed = np.abs(nav.vel_frd_m_s)
    slope = [(model.linear_drag[i] + 2.0 * model.quadratic_drag[i] * speed[i]) / model.mass_kg[i] for i in range(2)]
    munk = abs(m11 - m22) / m44 * math.hypot(speed[0], speed[1])
    return np.hypot(at_rest, np.array([slope[0], slope[1], 0.0, munk]) * flow_m_s)


class DisturbanceLevel:
    """Factors of the variance of disturbances, by axis; 1 where they are as the filters' beliefs have them.

    Covariance matching (Mehra 1970): where the innovations are larger than the filter expects, its disturbance is made
    larger until they are not. Waves push the same way for a second and the controller pushes back, so that late
    commands explain a part of them: evidence counts for less, the higher the level."""

    def __init__(self) -> None:
        self.factor: FloatArray = np.ones(AXES)
        """(4,)"""

    @property
    def evidence_share(self) -> float:
        """What evidence counts for, 1 to 0."""
        beyond = (float(self.factor.max()) - 1.0) / (DISTURBANCE_LEVEL.silent - 1.0)
        return max(0.0, 1.0 - beyond)

    def update(self, dt_s: float, innovation: FloatArray, s: FloatArray) -> None:
        """``innovation`` (4,) of the likeliest candidate, and its covariance ``s`` (4, 4)."""
        tuning = DISTURBANCE_LEVEL
        ratio = np.minimum(np.square(innovation) / np.diag(s), tuning.most_ratio)
        grown = np.exp(dt_s / tuning.follow_s * (ratio - 1.0))
        self.factor = np.clip(self.factor * grown, 1.0, tuning.most)


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayTuning:
    """Noise and prior of the filters; axes surge, sway, heave [m/s^2] and yaw [rad/s^2]."""

    interval_s: float = 0.1
    """Interval of updates and of candidates."""
    candidates: int = 16
    """Delays of 0 to 1.5 s."""
    filter_s: float = 0.2
    """T: slow enough to reduce the noise of gyro and velocity, fast enough to separate delays."""
    noise: tuple[float, float, float, float] = (0.03, 0.03, 0.03, 0.1)
    """Standard deviation of one update: estimate and model; updates T apart are independent."""
    noise_fraction: float = 0.08
    """Relative error of the thrust's acceleration by lag, dead band and supply voltage."""
    push: tuple[float, float, float, float] = (0.06, 0.05, 0.06, 0.1)
    """Standard deviation of d at rest: 1 N of tether, a moment of 0.03 N m."""
    flow_m_s: float = 0.1
    """Standard deviation of the current, which enters d through drag and Munk moment."""
    push_time_s: float = 4.0
    """Time within which d forgets itself."""
    current_s: float = 20.0
    """Time constant of the current: with late commands its estimate contains thrust that is not there."""
    arm: float = 0.1
    """Standard deviation of yaw by lateral thrust [rad/s^2 per N]: an arm of some cm is not in T_A."""
    prior: float = 0.25
    """Standard deviation of e before anything is known."""
    wander: float = 0.05
    """Random walk of e [1/sqrt(s)]: a thruster may fail."""
    surprise: float = 10.0
    """Largest evidence of one update [nats], for robustness against outliers."""
    lead: float = 30.0
    """No delay is further behind the likeliest than this (nats): a line may become late in flight."""
    forget_s: float = 20.0
    """Evidence fades within this time."""
    normal_s: float = 0.2
    """Delays up to here are explained by lag, sensors and supply, and are not reported."""
    suspect_evidence: float = 5.0
    """Evidence [nats] against all normal delays that is a warning."""
    certain: float = 10.0
    """Evidence against all normal delays, and that of all but one neighbourhood of delays, that declares a delay."""
    fits: float = 1.0
    """Evidence against a delay up to which it fits."""
    known: float = 3.0
    """Evidence against all but the likeliest delay and its neighbours that makes it known."""
    follow_s: float = 0.05
    """A declared delay changes when the estimate is further away than this."""
    confirm_s: float = 0.3
    """Time for which a delay must be certain before it is declared."""


class ActuationDelay:
    """Estimate of the delay between a command and its thrust. :meth:`step` at every tick, deterministic."""

    def __init__(self, model: Model4, response: Response) -> None:
        self._model = model
        self._response = response
        self._tuning = DelayTuning()
        self._effect = np.array(model.allocation) / np.array(model.mass_kg)[:, None]
        self._sway = np.array(model.allocation)[1]
        self.delays_s = self._tuning.interval_s * np.arange(self._tuning.candidates)
        """(n,) the candidates."""
        self.reset()

    def reset(self) -> None:
        """Discard all evidence; the delay is 0."""
        tuning = self._tuning
        n, nu = tuning.candidates, self._model.thrusters
        self._x = np.tile(np.concatenate([np.ones(nu), np.zeros(BESIDES)]), (n, 1))
        prior = np.diag([tuning.prior**2] * nu + [s * s for s in tuning.push] + [tuning.arm**2])
        self._p = np.tile(prior, (n, 1, 1))
        self._evidence = np.zeros(n)
        self._level = DisturbanceLevel()
        self._known: deque[tuple[FloatArray, FloatArray, FloatArray]] = deque(maxlen=UNLEARNED_LOOKS)
        self._past = np.zeros((n, nu))
        # Plain numbers for quantities of every tick: faster than arrays for so few.
        self._acting, self._thrust = [0.0] * nu, [0.0] * nu
        self._followed: Sequence[float] | None = None
        """(8,) of :func:`thrustless_motion`, filtered."""
        self._current: list[float] | None = None
        self._t_us: int | None = None
        self._since_s = self._wait_s = self._certain_s = 0.0
        self._reset_count = -1
        self.delay_s = 0.0
        """Command latency [s]; 0 until it is certain."""
        self.doubtful = False
        """Whether thrust that should have shown has not, and it is not known yet why."""

    @property
    def current_ned_m_s(self) -> FloatArray:
        """(3,) slowly filtered current, without the effect of thrust that has not acted yet."""
        return np.zeros(3) if self._current is None else np.array(self._current)

    @property
    def shortest_s(self) -> float:
        """The shortest delay that is consistent with the data; grows while there is no response."""
        return float(self.delays_s[int(np.argmax(self._evidence > -self._tuning.fits))])

    @property
    def probability(self) -> FloatArray:
        """(n,) probability of each candidate."""
        weight: FloatArray = np.exp(self._evidence - self._evidence.max())
        weight /= weight.sum()
        return weight

    def step(self, t_us: int, nav: NavState | None, thrust_n: FloatArray) -> bool:
        """``thrust_n`` (n,): steady thrust of the pulses since the last call [N]. True when the declared delay has
        changed.
        """
        dt_s = 0.0 if self._t_us is None else (t_us - self._t_us) * 1e-6
        self._t_us = t_us
        fraction = 1.0 - math.exp(-dt_s / self._tuning.filter_s)
        self._acting = self._response.after(dt_s, self._acting, thrust_n.tolist())
        self._thrust = _toward(self._thrust, self._acting, fraction)
        self._since_s += dt_s
        due = self._since_s >= self._tuning.interval_s - 1e-9
        update_s = min(self._since_s, 1.0)
        if due:
            self._since_s = 0.0
            self._past[1:] = self._past[:-1]
            self._past[0] = self._thrust
        if nav is None or nav.health is not NavHealth.GOOD:
            self._followed = None
            self._unlearn()
            return False
        if self._current is None:
            self._current = nav.current_ned_m_s.tolist()
        motion, followed = thrustless_motion(self._model, nav, self._current), self._followed
        if followed is None or nav.reset_count != self._reset_count:
            self._wait_s = 0.0 if followed is None and self._reset_count < 0 else 3.0 * self._tuning.filter_s
            self._reset_count, self._followed = nav.reset_count, motion
            return False
        self._wait_s -= dt_s
        self._current = _toward(self._current, nav.current_ned_m_s.tolist(), dt_s / self._tuning.current_s)
        self._followed = followed = _toward(followed, motion, fraction)
        if not due or self._wait_s > 0.0:
            return False
        self._known.append((self._x, self._p, self._evidence))
        self._update(
            update_s,
            push_sigma(self._model, nav, self._tuning.push, self._tuning.flow_m_s),
            np.subtract(motion[:AXES], followed[:AXES]) / self._tuning.filter_s - followed[AXES:],
        )
        return self._declare(update_s)

    def _unlearn(self) -> None:
        """Restore the state before the last updates: an estimate degrades before it is flagged."""
        if self._known:
            self._x, self._p, self._evidence = self._known[0]
            self._known.clear()
            self._certain_s = 0.0
            self.doubtful = False

    def _update(self, dt_s: float, push: FloatArray, residual: FloatArray) -> None:
        """Predict and update all filters; ``residual`` (4,) is the acceleration that thrust and d have to explain."""
        tuning, n, nu = self._tuning, self._tuning.candidates, self._model.thrusters
        keep = math.exp(-dt_s / tuning.push_time_s)
        fade = np.concatenate([np.ones(nu), np.full(AXES, keep), np.ones(1)])
        disturbed = self._level.factor * np.square(push)
        x, p = self._x * fade, self._p * np.outer(fade, fade)
        p += np.diag(
            np.concatenate([np.full(nu, tuning.wander**2 * dt_s), (1.0 - keep * keep) * disturbed, np.zeros(1)])
        )
        h = np.zeros((n, AXES, nu + BESIDES))
        h[:, :, :nu] = self._effect * self._past[:, None, :]
        h[:, :, nu : nu + AXES] = np.eye(AXES)
        h[:, 3, nu + AXES] = self._past @ self._sway
        # Looks closer together than T share their noise: each counts for its part.
        part = dt_s / (2.0 * tuning.filter_s)
        spread = np.abs(self._effect) @ np.abs(self._past).max(axis=0)
        noise = np.diag(np.square(tuning.noise) + np.square(tuning.noise_fraction * spread)) / part
        innovation = residual - np.einsum("nij,nj->ni", h, x)
        cross = h @ p
        s = cross @ h.transpose(0, 2, 1) + noise
        gain = np.linalg.solve(s, cross).transpose(0, 2, 1)
        x += np.einsum("nij,nj->ni", gain, innovation)
        x[:, :nu] = np.clip(x[:, :nu], 0.0, 1.5)
        rest = np.eye(nu + BESIDES) - gain @ h
        self._x, self._p = x, rest @ p @ rest.transpose(0, 2, 1) + gain @ noise @ gain.transpose(0, 2, 1)
        distance2 = np.einsum("ni,ni->n", innovation, np.linalg.solve(s, innovation[..., None])[..., 0])
        best = int(self._evidence.argmax())
        self._level.update(dt_s, innovation[best], s[best])
        log_likelihood = -0.5 * (distance2 + np.log(np.linalg.det(s)))
        log_likelihood = np.maximum(log_likelihood - log_likelihood.max(), -tuning.surprise)
        self._evidence = (
            self._evidence * math.exp(-dt_s / tuning.forget_s) + self._level.evidence_share * log_likelihood
        )
        self._evidence = np.maximum(self._evidence - self._evidence.max(), -tuning.lead)

    def _declare(self, dt_s: float) -> bool:
        """Conclude from the evidence; True when the declared delay has changed."""
        tuning, evidence = self._tuning, self._evidence
        normal = float(evidence[self.delays_s < tuning.normal_s + 1e-9].max())
        best = int(evidence.argmax())
        far = np.abs(np.arange(tuning.candidates) - best) > 1
        known = float(evidence[far].max()) < -tuning.known
        late = normal < -tuning.certain
        self._certain_s = self._certain_s + dt_s if late and known else 0.0
        before = self.delay_s
        if self._certain_s >= tuning.confirm_s - 1e-9:
            near = ~far
            mean_s = float(self.probability[near] @ self.delays_s[near] / self.probability[near].sum())
            if abs(mean_s - self.delay_s) > tuning.follow_s:
                self.delay_s = mean_s
        elif self.delay_s and float(evidence[self.delays_s > tuning.normal_s + 1e-9].max()) < -tuning.certain:
            self.delay_s = 0.0
        self.doubtful = self.delay_s == 0.0 and normal < -tuning.suspect_evidence
        return self.delay_s != before


def _toward(values: Sequence[float], goals: Sequence[float], fraction: float) -> list[float]:
    """Linear interpolation by that fraction."""
    return [value + fraction * (goal - value) for value, goal in zip(values, goals, strict=True)]


class CommandDelay:
    """Estimates the command latency while armed (LAT_DETECT) and holds the pulses that have not acted yet."""

    def __init__(self, vehicle: Vehicle, params: ParamSet) -> None:
        self._params = params
        self._delay = ActuationDelay(vehicle.to_model(), Response.of(vehicle.thrusters))
        self._kept_us = round(float(self._delay.delays_s[-1]) * 1e6) + 1
        self._sent: deque[tuple[int, FloatArray]] = deque()
        self._suspect_since_us: int | None = None
        self._looked = False
        self._found_us: int | None = None
        self.delay_s = 0.0
        """Command latency [s]; 0 until it is certain."""
        self.doubtful = False
        """Thrust has shown no effect yet though it should have, and it is not known how late it will: no more of it."""

    @property
    def prompt(self) -> bool:
        """Whether the estimated latency is zero."""
        return self.delay_s == 0.0 and not self.doubtful

    def send(self, t_us: int, pulse_n: FloatArray) -> FloatArray:
        """(n,) thrust that acts now [N]. ``pulse_n`` (n,): thrust of healthy thrusters for the pulses since the last
        call.
        """
        self._sent.append((t_us, pulse_n))
        while self._sent[0][0] < t_us - self._kept_us:
            self._sent.popleft()
        since_us = t_us - round((self._delay.shortest_s if self.doubtful else self.delay_s) * 1e6)
        for sent_us, sent_n in reversed(self._sent):
            if sent_us <= since_us:
                return sent_n
        return np.zeros_like(pulse_n)

    def step(self, t_us: int, nav: NavState | None, *, armed: bool) -> None:
        """Learn from the estimate of now, after :meth:`send`. Disarmed, everything is forgotten."""
        if not armed or not int(self._params["LAT_DETECT"]):
            self.delay_s, self.doubtful, self._suspect_since_us, self._found_us = 0.0, False, None, None
            if self._looked:
                self._delay.reset()
            self._looked = False
            return
        self._looked = True
        self._delay.step(t_us, nav, self._sent[-1][1])
        self.delay_s = self._delay.delay_s
        self._found_us = (t_us if self._found_us is None else self._found_us) if self.delay_s else None
        self._suspect_since_us = (self._suspect_since_us or t_us) if self._delay.doubtful else None
        self.doubtful = self._suspect_since_us is not None and t_us - self._suspect_since_us < LONGEST_DOUBT_S * 1e6

    def nav_for_control(self, t_us: int, nav: NavState) -> NavState:
        """The estimate for the controller: just after a delay has been found with the current of before."""
        if self._found_us is None or t_us - self._found_us > SETTLE_S * 1e6:
            return nav
        current = self._delay.current_ned_m_s
        c, s = math.cos(nav.rpy_rad[2]), math.sin(nav.rpy_rad[2])
        flow = np.array([c * current[0] + s * current[1], c * current[1] - s * current[0], current[2]])
        return replace(nav, current_ned_m_s=current, vel_water_frd_m_s=nav.vel_frd_m_s - flow)
