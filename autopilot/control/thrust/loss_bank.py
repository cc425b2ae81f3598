"""Thruster fault detection and isolation by a bank of Kalman filters and their likelihood ratios.

Filter 0 assumes that the effectiveness of each thruster is as declared. Filter 1 takes all of them as unknown; its
standard deviations show how well each thruster is observable. Every other filter is a hypothesis: one thruster changed
at the hypothesis' start, a healthy one to half or almost no thrust, a faulty one back to healthy.

Beside the effectiveness e all of them estimate the other causes of the motion, each with a prior of realistic spread:
thrust over mass and drag over mass of each axis, Coriolis and Munk terms, the lag, the lateral arm of the thrust, a
steady force from a fixed direction (tether), a moment, the current, and disturbances of a second or two. Model errors,
tugs and gusts are therefore not declared as faults: a fault has to be by far the more likely hypothesis.

The current appears twice, in the drag and in the Munk moment. Both depend on the same water, but the effect of its
error on the moment is a product of two unknowns: a vehicle whose masses are 15 % from its file has a Munk moment of
twice the file's. With one current for both, an error of 0.1 m/s turns such a hull by an amount that only a thruster
fault can explain; with two independent ones, the Munk moment hides half a thruster. They are therefore two states,
correlated as far as the masses are known (``Beliefs.munk``). Filters that multiply the two converge to wrong
equilibria.

The evidence for a hypothesis over filter 0 is the sum of their log-likelihood ratios since its start (generalised
likelihood ratio test with estimated size of the change: Willsky and Jones 1976). Each thruster has a few hypotheses
with different starts; every other second the least likely one is restarted.

Waves push to and fro and the controller pushes back: thrust goes with the disturbance, cycle after cycle in the same
way, and a weak thruster explains a part of it. Waves beyond ``Beliefs.waves_m_s2`` are therefore noise of surge and
sway. What is left grows slowly; in waves every update loses some evidence (``Beliefs.waves_cost``), and a thruster
that is lost outgrows it.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from autopilot.control.thrust.filtered_motion import FilteredMotion
from autopilot.control.thrust.thrust_tuning import LOSS_BANK
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import Model4


class StateLayout:
    """Indices of the states for ``n`` thrusters."""

    def __init__(self, n: int) -> None:
        self.e = slice(0, n)
        """Effectiveness of the thrusters."""
        self.gain = slice(n, n + 4)
        """Thrust over mass, per axis."""
        self.drag = slice(n + 4, n + 8)
        """Drag over mass, per axis."""
        self.turn = slice(n + 8, n + 11)
        """Coriolis (surge, sway) and Munk terms."""
        self.arm = n + 11
        """Of thrust to the side."""
        self.lag = n + 12
        self.pull = slice(n + 13, n + 16)
        """Force NED."""
        self.moment = n + 16
        self.flow = slice(n + 17, n + 19)
        """The water's velocity NE as drag feels it."""
        self.push = slice(n + 19, n + 23)
        """Per axis."""
        self.common = n + 23
        """Thrust of all axes."""
        self.swirl = slice(n + 24, n + 26)
        """The water's velocity NE as the Munk moment feels it."""
        self.size = n + 26
        self.motion = np.array([*range(n + 13, n + 23), n + 24, n + 25])
        """States that change within seconds."""
        self.filters = 2 + n * LOSS_BANK.each
        self.hypotheses = np.arange(2, self.filters)
        """Their filters."""
        self.thruster_of = np.repeat(np.arange(n), LOSS_BANK.each)
        """(n EACH,) thruster of each hypothesis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beliefs:
    """Standard deviations, axes surge, sway, heave [m/s^2] and yaw [rad/s^2]."""

    noise: tuple[float, float, float, float] = (0.008, 0.008, 0.008, 0.04)
    """Of one update: estimate and model; updates ``independent_s`` apart are independent."""
    noise_fraction: float = 0.04
    """Relative error of the thrust's acceleration by lag, dead band and supply voltage."""
    independent_s: float = 0.3
    """Looks so far apart share no noise."""
    healthy: float = 0.05
    """e of a sound thruster: they are not all alike."""
    half: tuple[float, float] = (0.5, 0.1)
    """e of a thruster that has lost half of its thrust, mean and standard deviation."""
    dead: tuple[float, float] = (0.1, 0.12)
    """The same of one that has lost nearly all."""
    unknown: float = 0.3
    """e of the filter that knows of no thruster."""
    wander: float = 0.01
    """e of a lossy thruster, per square root of a second."""
    gain: tuple[float, float, float, float] = (0.14, 0.14, 0.14, 0.17)
    """Errors of mass and lever arm."""
    common: float = 0.15
    """Errors of the thrust constant, of all thrusters alike."""
    least_gain: float = -0.45
    """Smallest total error of an axis: 0.3 less thrust and 0.2 more mass. Below that it is a fault."""
    gain_wander: float = 0.003
    """Per square root of a second."""
    drag: float = 0.3
    """Share of drag over mass."""
    turn: tuple[float, float, float] = (0.25, 0.25, 0.5)
    """Share of the Coriolis terms and of the Munk moment, a difference of masses."""
    arm: float = 0.1
    """Yaw by lateral thrust [rad/s^2 per N]: an arm of some cm is not in T_A."""
    lag_s: float = 0.06
    """Of the thrusters and of what is measured."""
    pull_n: float = 1.0
    """Force from a fixed direction: a tether."""
    pull_s: float = 20.0
    """Correlation time of its direction."""
    moment: float = 0.2
    """Yaw disturbance [rad/s^2]."""
    moment_s: float = 3.0
    """Correlation time."""
    flow_m_s: float = 0.12
    """Error of the estimated current in the drag: separates it from a thruster fault."""
    flow_hit_m_s: float = 0.3
    """The same after a collision: the estimated current contains the contact force."""
    flow_s: float = 6.0
    """Correlation time."""
    munk: tuple[float, float] = (1.5, 0.8)
    """Munk moment as a multiple of the file's, mean and standard deviation: so much more of the water it feels."""
    push: tuple[float, float, float, float] = (0.02, 0.02, 0.02, 0.07)
    """Unmodelled disturbance of each axis [m/s^2, rad/s^2]."""
    push_s: float = 1.5
    """Correlation time."""
    gate: float = 20.0
    """Squared Mahalanobis distance (4 axes) from all filters above which an update is a collision."""
    begin_s: float = 2.0
    """Interval of new hypotheses of each thruster."""
    grown_s: float = 3.0
    """Age from which a hypothesis may be restarted."""
    most: tuple[float, float] = (1.0, 0.4)
    """Largest evidence of one update, against and for a hypothesis [nats]: one tug is not enough."""
    most_evidence: float = 40.0
    """Evidence in all at most."""
    waves_m_s2: float = 0.08
    """Root mean square acceleration of the water to and fro up to which evidence counts in full: a tank's jet that is
    crossed makes 0.05, a wave of 0.05 m and 3 s 0.11."""
    waves_cost: float = 0.1
    """Evidence that an update loses for each ``waves_m_s2`` above it [nats]."""


class Memory(NamedTuple):
    x: FloatArray
    p: FloatArray
    evidence: FloatArray
    age_s: FloatArray
    since_s: float
    lossy: tuple[bool, ...]


class LossBank:
    """Evidence for a change of each thruster. Deterministic."""

    def __init__(self, model: Model4) -> None:
        self._beliefs = Beliefs()
        self._mass = np.array(model.mass_kg)
        self._effect = np.array(model.allocation) / self._mass[:, None]
        self._sway = np.array(model.allocation)[1]
        self._n, self._at = model.thrusters, StateLayout(model.thrusters)
        self._still = self._stationary()
        self._work = np.empty((self._at.filters, self._at.size, self._at.size))
        """Kept for :meth:`_shrink`: memory that is in use stays in the processor's cache."""
        self._evidence: FloatArray = np.zeros(len(self._at.hypotheses))
        self._age_s: FloatArray = np.zeros(len(self._at.hypotheses))
        self.reset()

    def reset(self) -> None:
        """All thrusters healthy, initial covariance."""
        self.lossy = (False,) * self._n
        """Effectiveness assumed by filter 0."""
        self._x, self._p = self._prior()
        self._begin_all()

    def restart_estimates(self) -> None:
        """Reset the estimates of the vehicle; declared faults are kept."""
        x, p = self._prior()
        lossy = np.flatnonzero(self.lossy)
        x[0, lossy], p[0, lossy, lossy] = self._x[0, lossy], self._p[0, lossy, lossy]
        self._x, self._p = x, p
        self._begin_all()

    def _prior(self) -> tuple[FloatArray, FloatArray]:
        b, at = self._beliefs, self._at
        x = np.zeros(at.size)
        x[at.e] = 1.0
        spread = np.zeros(at.size)
        spread[at.e], spread[at.gain], spread[at.drag], spread[at.turn] = b.healthy, b.gain, b.drag, b.turn
        spread[at.arm], spread[at.lag], spread[at.common] = b.arm, b.lag_s, b.common
        p = np.diag(np.square(spread))
        p += self._still
        xs, ps = np.tile(x, (at.filters, 1)), np.tile(p, (at.filters, 1, 1))
        ps[LOSS_BANK.free, range(self._n), range(self._n)] = b.unknown**2
        return xs, ps

    @property
    def evidence(self) -> FloatArray:
        """(n,) log-likelihood ratio [nats] of the best hypothesis of each thruster over filter 0."""
        result: FloatArray = self._evidence.reshape(self._n, LOSS_BANK.each).max(axis=1)
        return result

    def _best(self) -> FloatArray:
        """(n,) filters of the best hypotheses."""
        best: FloatArray = (
            2 + LOSS_BANK.each * np.arange(self._n) + self._evidence.reshape(self._n, LOSS_BANK.each).argmax(axis=1)
        )
        return best

    @property
    def changed_to(self) -> FloatArray:
        """(n,) effectiveness of each thruster if it has changed."""
        result: FloatArray = self._x[self._best(), np.arange(self._n)]
        return result

    @property
    def declared(self) -> tuple[FloatArray, FloatArray]:
        """(n,) effectiveness and its standard deviation in filter 0: that of faulty thrusters as declared."""
        at = self._at
        return self._x[0, at.e].copy(), np.sqrt(np.diag(self._p[0])[at.e])

    @property
    def free(self) -> tuple[FloatArray, FloatArray]:
        """(n,) effectiveness and its standard deviation in filter 1 (no prior): observability of each thruster."""
        at = self._at
        return self._x[LOSS_BANK.free, at.e].copy(), np.sqrt(np.diag(self._p[LOSS_BANK.free])[at.e])

    def sum_sigma(self, redundant: np.ndarray) -> FloatArray:
        """(n,) standard deviation of the total of each thruster and its ``twins`` (n, n), in filter 1."""
        of_e = self._p[LOSS_BANK.free][self._at.e, self._at.e]
        together = redundant.astype(float)
        result: FloatArray = np.sqrt(np.einsum("ij,jk,ik->i", together, of_e, together))
        return result

    @property
    def memory(self) -> Memory:
        """A snapshot of the bank, immutable."""
        return Memory(self._x, self._p, self._evidence, self._age_s, self._since_s, self.lossy)

    def recall(self, memory: Memory) -> None:
        self._x, self._p, self._evidence, self._age_s, self._since_s, self.lossy = memory

    def accept(self, thruster: int) -> None:
        """Replace filter 0 by the best hypothesis of this thruster."""
        best = int(self._best()[thruster])
        self._x, self._p = self._x.copy(), self._p.copy()
        self._x[0], self._p[0] = self._x[best], self._p[best]
        self._turn(thruster)

    def clear(self, thruster: int) -> None:
        """Set the faulty thruster to healthy in filter 0."""
        self._x, self._p = self._x.copy(), self._p.copy()
        self._set(0, thruster, 1.0, self._beliefs.healthy)
        self._turn(thruster)

    def swap(self, thruster: int, other: int) -> None:
        """Exchange the faulty thruster with its redundant one in filter 0."""
        order = np.arange(self._at.size)
        order[[thruster, other]] = other, thruster
        self._x, self._p = self._x.copy(), self._p.copy()
        self._x[0], self._p[0] = self._x[0][order], self._p[0][np.ix_(order, order)]
        lossy = list(self.lossy)
        lossy[thruster], lossy[other] = lossy[other], lossy[thruster]
        self.lossy = tuple(lossy)
        self._begin_all()

    def _turn(self, thruster: int) -> None:
        self.lossy = tuple(was != (i == thruster) for i, was in enumerate(self.lossy))
        self._begin_all()

    def forget_motion(self, *, hit: bool = False) -> None:
        """Reset the fast states; after a collision (``hit``) also the current, whose estimate contains it."""
        at = self._at
        self._x, self._p = self._x.copy(), self._p.copy()
        self._x[:, at.motion] = 0.0
        self._p[:, at.motion, :] = 0.0
        self._p[:, :, at.motion] = 0.0
        self._p += self._still
        if hit:
            self._p += self._waters(self._beliefs.flow_hit_m_s)
            self._begin_all()

    def update(self, motion: FilteredMotion, *, heave: bool, learn: bool) -> bool:
        """Measurement update, without learning if ``learn`` is false. False if no filter explains it: nothing is
        changed then.

        ``heave``: whether the third axis is valid (not at the surface).
        """
        b, at = self._beliefs, self._at
        self._predict(motion)
        pull = self._pull(motion)
        h = self._derivatives(motion, pull)
        thrust = np.square(self._effect) @ np.square(motion.thrust_n)
        known = np.square(b.noise) + b.noise_fraction**2 * thrust + np.square(motion.swing)
        known[:2] += 2.0 * max(0.0, motion.waves_m_s2**2 - b.waves_m_s2**2)  # the square of their amplitude
        noise = known * (b.independent_s / motion.dt_s)
        if not heave:
            noise[2] = LOSS_BANK.unseen
        innovation = motion.residual - self._expected(motion, h, pull)
        cross = h @ self._p
        s = cross @ h.transpose(0, 2, 1) + np.diag(noise)
        inverse = np.linalg.inv(s)
        distance2 = np.einsum("ni,nij,nj->n", innovation, inverse, innovation)
        explained = bool(distance2.min() < b.gate)
        if explained and learn:
            gain = cross.transpose(0, 2, 1) @ inverse
            x = self._x + np.einsum("nij,nj->ni", gain, innovation)
            x[:, at.e] = np.clip(x[:, at.e], 0.0, 1.5)
            # No sound vehicle is so heavy and so weak as a lost thruster would have it.
            x[:, at.gain] = np.maximum(x[:, at.gain], b.least_gain - x[:, at.common, None])
            self._x = x
            self._shrink(gain, cross)
            self._weigh(-0.5 * (distance2 + np.log(np.linalg.det(s))), motion)
        return explained

    def _shrink(self, gain: FloatArray, cross: FloatArray) -> None:
        """Covariances after an update, in place: they belong to the predicted ones, which nothing else uses."""
        p, work = self._p, self._work
        p -= np.matmul(gain, cross, out=work)
        np.add(p, p.transpose(0, 2, 1), out=work)
        np.multiply(work, 0.5, out=p)

    def _weigh(self, log_likelihood: FloatArray, motion: FilteredMotion) -> None:
        """Add the log-likelihoods (n,) of an update to the evidence; restart hypotheses on schedule."""
        b, at = self._beliefs, self._at
        gained = np.clip(log_likelihood[at.hypotheses] - log_likelihood[0], -b.most[0], b.most[1])
        gained -= b.waves_cost * max(0.0, motion.waves_m_s2 / b.waves_m_s2 - 1.0)
        self._evidence = np.minimum(self._evidence + gained, b.most_evidence)
        self._age_s = self._age_s + motion.dt_s
        self._since_s += motion.dt_s
        if self._since_s >= b.begin_s - 1e-9:
            self._since_s = 0.0
            self._begin_worst()

    def _begin_all(self) -> None:
        """Restart all hypotheses; of those with equal start the first counts as the best."""
        self._evidence, self._age_s = np.zeros(len(self._at.hypotheses)), np.zeros(len(self._at.hypotheses))
        self._since_s = 0.0
        for hypothesis in range(len(self._at.hypotheses)):
            self._begin(hypothesis)

    def _begin_worst(self) -> None:
        """Restart the least likely hypothesis of each thruster and each size of loss, if it is old enough."""
        grown = self._age_s >= self._beliefs.grown_s
        evidence_of_old = np.where(grown, self._evidence, np.inf).reshape(self._n, LOSS_BANK.each // 2, 2)
        worst = LOSS_BANK.each * np.arange(self._n)[:, None] + 2 * evidence_of_old.argmin(axis=1) + np.arange(2)
        self._evidence, self._age_s = self._evidence.copy(), self._age_s.copy()
        for hypothesis in worst.ravel():
            if grown[hypothesis]:
                self._begin(int(hypothesis))

    def _begin(self, hypothesis: int) -> None:
        """Restart a hypothesis: filter 0 with a change of its thruster now."""
        b, at = self._beliefs, self._at
        thruster = int(at.thruster_of[hypothesis])
        mean, sigma = (1.0, b.healthy) if self.lossy[thruster] else (b.half, b.dead)[hypothesis % 2]
        here = int(at.hypotheses[hypothesis])
        self._x[here], self._p[here] = self._x[0], self._p[0]
        self._set(here, thruster, mean, sigma)
        self._evidence[hypothesis] = self._age_s[hypothesis] = 0.0

    def _set(self, which: int, thruster: int, mean: float, sigma: float) -> None:
        """Set the thruster's mean and variance in filter ``which``, without correlations."""
        self._x[which, thruster] = mean
        self._p[which, thruster, :] = self._p[which, :, thruster] = 0.0
        self._p[which, thruster, thruster] = sigma**2

    def _stationary(self) -> FloatArray:
        """(n, n) covariance of the states that change within seconds."""
        b, at = self._beliefs, self._at
        still = np.zeros(at.size)
        still[at.pull], still[at.moment], still[at.push] = b.pull_n**2, b.moment**2, np.square(b.push)
        return np.diag(still) + self._waters(b.flow_m_s)

    def _waters(self, sigma_m_s: float) -> FloatArray:
        """(n, n) covariance of the current's error in drag and in the Munk moment."""
        at, (mean, sigma) = self._at, self._beliefs.munk
        waters = np.zeros((at.size, at.size))
        waters[at.flow, at.flow] = np.eye(2) * sigma_m_s**2
        waters[at.flow, at.swirl] = waters[at.swirl, at.flow] = np.eye(2) * mean * sigma_m_s**2
        waters[at.swirl, at.swirl] = np.eye(2) * (mean**2 + sigma**2) * sigma_m_s**2
        return waters

    def _predict(self, motion: FilteredMotion) -> None:
        b, at, dt_s = self._beliefs, self._at, motion.dt_s
        keep = np.ones(at.size)
        keep[at.pull], keep[at.moment] = math.exp(-dt_s / b.pull_s), math.exp(-dt_s / b.moment_s)
        keep[at.flow] = keep[at.swirl] = math.exp(-dt_s / b.flow_s)
        keep[at.push] = math.exp(-dt_s / b.push_s)
        x, kept = self._x * keep, np.outer(keep, keep)
        p = self._p * kept
        p += (1.0 - kept) * self._still
        # The same water, against another belief.
        x[:, at.flow] -= motion.moved_ned_m_s
        x[:, at.swirl] -= motion.moved_ned_m_s
        grow = np.zeros((at.filters, at.size))
        grow[:, at.gain] = b.gain_wander**2 * dt_s
        lossy = np.tile(self.lossy, (at.filters, 1))
        lossy[LOSS_BANK.free] = True
        lossy[at.hypotheses, at.thruster_of] ^= True
        grow[:, at.e] = b.wander**2 * dt_s * lossy
        index = np.arange(at.size)
        p[:, index, index] += grow
        self._x, self._p = x, p

    def _expected(self, motion: FilteredMotion, h: FloatArray, pull: FloatArray) -> FloatArray:
        """(n, 4) residual that each filter expects, with its derivatives (n, 4, states)."""
        x, at = self._x, self._at
        ideal, rate = h[:, :, at.common], -h[:, :, at.lag]
        result: FloatArray = (
            self._gain() * ideal - x[:, at.lag, None] * rate + x[:, at.drag] * motion.drag + x[:, at.push]
        )
        result += x[:, at.pull] @ pull.T
        result[:, :3] += x[:, at.flow] @ motion.flow[:3].T
        result[:, 3] += x[:, at.swirl] @ motion.flow[3]
        result[:, [0, 1, 3]] += x[:, at.turn] * motion.coriolis
        result[:, 3] += x[:, at.moment] + x[:, at.arm] * (motion.thrust_n @ self._sway)
        return result

    def _derivatives(self, motion: FilteredMotion, pull: FloatArray) -> FloatArray:
        """(n, 4, states) Jacobian of the predicted measurement."""
        x, at = self._x, self._at
        h = np.zeros((len(x), 4, at.size))
        axes = np.arange(4)
        h[:, :, at.e] = self._gain()[:, :, None] * (self._effect * motion.thrust_n) - x[:, at.lag, None, None] * (
            self._effect * motion.thrust_rate_n_s
        )
        h[:, axes, at.gain.start + axes] = h[:, :, at.common] = np.einsum(
            "ij,nj->ni", self._effect, motion.thrust_n * x[:, at.e]
        )
        h[:, axes, at.drag.start + axes] = motion.drag
        h[:, [0, 1, 3], range(at.turn.start, at.turn.stop)] = motion.coriolis
        h[:, 3, at.arm] = motion.thrust_n @ self._sway
        h[:, :, at.lag] = -np.einsum("ij,nj->ni", self._effect, motion.thrust_rate_n_s * x[:, at.e])
        h[:, :, at.pull] = pull
        h[:, 3, at.moment] = 1.0
        h[:, :3, at.flow] = motion.flow[:3]
        h[:, 3, at.swirl] = motion.flow[3]
        h[:, axes, at.push.start + axes] = 1.0
        return h

    def _gain(self) -> FloatArray:
        """(n, 4) thrust over mass of each axis relative to the vehicle file."""
        at = self._at
        return 1.0 + self._x[:, at.gain] + self._x[:, at.common, None]

    def _pull(self, motion: FilteredMotion) -> FloatArray:
        """(4, 3) acceleration per newton of a force NED."""
        c, s = motion.north
        pull = np.zeros((4, 3))
        pull[0, :2] = c, s
        pull[1, :2] = -s, c
        pull[2, 2] = 1.0
        per_newton: FloatArray = pull / self._mass[:, None]
        return per_newton
