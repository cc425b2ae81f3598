"""Which thruster explains the motion better by being lossy: a bank of Kalman filters and the evidence between them.

Filter 0 believes that the thrusters are as they have been declared. Filter 1 takes all of them for unknown: its
standard deviations say what can be seen of a thruster at all. Every other filter is a story: one thruster changed
when the story began, a sound one lost half of its thrust or nearly all, a lossy one is sound again.

All of them estimate beside the effectiveness e of the thrusters what else may explain the motion, each with the
spread that vehicles and waters have: thrust over mass and drag over mass of each axis, Coriolis and Munk terms, the
lag, the arm of the lateral thruster, a steady force from a fixed direction (a tether), a moment, the water's velocity,
and pushes that last a second or two. A mistake of the model, a tug and a gust are therefore no loss: it is declared
only where it is by far the likelier story.

The water's velocity stands there twice, for drag and for the Munk moment. They feel the same water, but what the moment
makes of an error of it is the product of two unknowns: a vehicle whose masses are 15 % from its file has a Munk moment
of twice the file's. With one water for both, a current that is wrong by 0.1 m/s turns such a hull by what only a lost
thruster can explain; with two that know nothing of each other, the Munk moment hides half a thruster. So they are two
that go together as far as the masses do (``Beliefs.munk``). Filters that multiply the two come to
rest in different wrong places.

The evidence for a story over filter 0 is the sum of their log-likelihood ratios since it began (a generalised
likelihood ratio test with the size of the change estimated: Willsky and Jones 1976). Each thruster has a few stories
that began at different times; every other second the one that is believed least begins anew.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from autopilot.control.thrust.motion_looks import Look
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NU, Model4

LATERAL = 3
"""Index of the lateral thruster."""

E, GAIN, DRAG, TURN, ARM, LAG, PULL, MOMENT, FLOW, PUSH, COMMON, SWIRL = (
    slice(0, 4),
    slice(4, 8),
    slice(8, 12),
    slice(12, 15),
    15,
    16,
    slice(17, 20),
    20,
    slice(21, 23),
    slice(23, 27),
    27,
    slice(28, 30),
)
"""States: effectiveness (4), thrust over mass per axis (4), drag over mass per axis (4), Coriolis and Munk (3), arm of
the lateral thruster, lag, force NED (3), moment, water's velocity NE as drag feels it (2), push per axis (4), thrust of
all axes, water's velocity NE as the Munk moment feels it (2)."""

STATES = 30
MOTION = np.array([*range(17, 27), 28, 29])
"""States that change within seconds."""

FREE = 1
"""The filter to which all thrusters are unknown."""

EACH = 6
"""Stories per thruster, one half of half a thruster, the other of a dead one."""

FILTERS = 2 + NU * EACH

TOLD_OF = np.repeat(np.arange(NU), EACH)
"""(24,) thruster that a story tells of."""

UNSEEN = 1e6
"""Variance of an axis that says nothing."""

STORIES = np.arange(2, FILTERS)
"""Their filters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beliefs:
    """Standard deviations, axes surge, sway, heave [m/s^2] and yaw [rad/s^2]."""

    noise: tuple[float, float, float, float] = (0.008, 0.008, 0.008, 0.04)
    """Of one look: estimate and model, looks ``independent_s`` apart being independent."""
    noise_share: float = 0.04
    """Of the thrust's acceleration: lag, deadband and supply are not known better."""
    independent_s: float = 0.3
    """Looks so far apart share no noise."""
    sound: float = 0.05
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
    """Smallest error of an axis in all: 0.3 less thrust and 0.2 more mass. What is less is a loss."""
    gain_wander: float = 0.003
    """Per square root of a second."""
    drag: float = 0.3
    """Share of drag over mass."""
    turn: tuple[float, float, float] = (0.25, 0.25, 0.5)
    """Share of the Coriolis terms and of the Munk moment, a difference of masses."""
    arm: float = 0.1
    """What the lateral thruster turns [rad/s^2 per N]: its arm of some cm is not in T_A."""
    lag_s: float = 0.06
    """Of the thrusters and of what is measured."""
    pull_n: float = 1.0
    """Force from a fixed direction: a tether."""
    pull_s: float = 20.0
    """It turns within this time."""
    moment: float = 0.2
    """What turns the hull besides, [rad/s^2]."""
    moment_s: float = 3.0
    """It is another within this time."""
    flow_m_s: float = 0.12
    """The water's velocity against the estimated current, as drag feels it: explains what a lost thruster does not."""
    flow_hit_m_s: float = 0.3
    """The same after a collision: the estimator has taken what held the hull for water."""
    flow_s: float = 6.0
    """It is another within this time."""
    munk: tuple[float, float] = (1.5, 0.8)
    """Munk moment as a multiple of the file's, mean and standard deviation: so much more of the water it feels."""
    push: tuple[float, float, float, float] = (0.02, 0.02, 0.02, 0.07)
    """What nobody knows."""
    push_s: float = 1.5
    """It is another within this time."""
    gate: float = 20.0
    """Squared distance (4 axes) from all filters beyond which a look tells of a collision, not of thrusters."""
    begin_s: float = 2.0
    """A new story of each thruster so often."""
    grown_s: float = 3.0
    """So long a story is listened to."""
    most: tuple[float, float] = (1.0, 0.4)
    """Evidence of one look at most, against and for a story [nats]: what one tug tells is not enough."""
    most_evidence: float = 40.0
    """Evidence in all at most."""


class Memory(NamedTuple):
    """What a bank knows."""

    x: FloatArray
    p: FloatArray
    evidence: FloatArray
    age_s: FloatArray
    since_s: float
    lossy: tuple[bool, ...]


class LossBank:
    """Evidence for a change of each of four thrusters. Deterministic."""

    def __init__(self, model: Model4, beliefs: Beliefs | None = None) -> None:
        self._beliefs = beliefs or Beliefs()
        self._mass = np.array(model.mass_kg)
        self._effect = np.array(model.allocation) / self._mass[:, None]
        self._still = self._stationary()
        self._evidence: FloatArray = np.zeros(len(STORIES))
        self._age_s: FloatArray = np.zeros(len(STORIES))
        self.reset()

    def reset(self) -> None:
        """All thrusters are sound, nothing is known."""
        self.lossy = (False,) * NU
        """What filter 0 believes."""
        self._x, self._p = self._prior()
        self._begin_all()

    def doubt(self) -> None:
        """What was known of the vehicle does not hold any more; what was declared stays."""
        x, p = self._prior()
        lossy = np.flatnonzero(self.lossy)
        x[0, lossy], p[0, lossy, lossy] = self._x[0, lossy], self._p[0, lossy, lossy]
        self._x, self._p = x, p
        self._begin_all()

    def _prior(self) -> tuple[FloatArray, FloatArray]:
        """States and covariances when nothing is known."""
        b = self._beliefs
        x = np.zeros(STATES)
        x[E] = 1.0
        spread = np.zeros(STATES)
        spread[E], spread[GAIN], spread[DRAG], spread[TURN] = b.sound, b.gain, b.drag, b.turn
        spread[ARM], spread[LAG], spread[COMMON] = b.arm, b.lag_s, b.common
        p = np.diag(np.square(spread))
        p += self._still
        xs, ps = np.tile(x, (FILTERS, 1)), np.tile(p, (FILTERS, 1, 1))
        ps[FREE, range(NU), range(NU)] = b.unknown**2
        return xs, ps

    @property
    def evidence(self) -> FloatArray:
        """(4,) for a change of each thruster: of its best story [nats]."""
        result: FloatArray = self._evidence.reshape(NU, EACH).max(axis=1)
        return result

    def _best(self) -> FloatArray:
        """(4,) filters of the best stories."""
        best: FloatArray = 2 + EACH * np.arange(NU) + self._evidence.reshape(NU, EACH).argmax(axis=1)
        return best

    @property
    def changed_to(self) -> FloatArray:
        """(4,) effectiveness of each thruster if it has changed."""
        result: FloatArray = self._x[self._best(), np.arange(NU)]
        return result

    @property
    def declared(self) -> tuple[FloatArray, FloatArray]:
        """(4,) effectiveness as filter 0 has it, and its standard deviation: what a lossy thruster gives."""
        return self._x[0, E].copy(), np.sqrt(np.diag(self._p[0])[E])

    @property
    def free(self) -> tuple[FloatArray, FloatArray]:
        """(4,) effectiveness of all thrusters without any belief, and its standard deviation: what can be seen."""
        return self._x[FREE, E].copy(), np.sqrt(np.diag(self._p[FREE])[E])

    @property
    def memory(self) -> Memory:
        """All that is known; nothing of it changes any more."""
        return Memory(self._x, self._p, self._evidence, self._age_s, self._since_s, self.lossy)

    def recall(self, memory: Memory) -> None:
        """Know only what was known then."""
        self._x, self._p, self._evidence, self._age_s, self._since_s, self.lossy = memory

    def accept(self, thruster: int) -> None:
        """Filter 0 believes from now on what the best story of this thruster tells."""
        best = int(self._best()[thruster])
        self._x, self._p = self._x.copy(), self._p.copy()
        self._x[0], self._p[0] = self._x[best], self._p[best]
        self._turn(thruster)

    def clear(self, thruster: int) -> None:
        """Filter 0 believes from now on that the lossy thruster is sound."""
        self._x, self._p = self._x.copy(), self._p.copy()
        self._set(0, thruster, 1.0, self._beliefs.sound)
        self._turn(thruster)

    def _turn(self, thruster: int) -> None:
        self.lossy = tuple(was != (i == thruster) for i, was in enumerate(self.lossy))
        self._begin_all()

    def forget_motion(self, *, hit: bool = False) -> None:
        """What changes within seconds is not known any more; what ``hit`` the hull is in the estimated current."""
        self._x, self._p = self._x.copy(), self._p.copy()
        self._x[:, MOTION] = 0.0
        self._p[:, MOTION, :] = 0.0
        self._p[:, :, MOTION] = 0.0
        self._p += self._still
        if hit:
            self._p += self._waters(self._beliefs.flow_hit_m_s)
            self._begin_all()

    def look(self, look: Look, *, heave: bool, learn: bool) -> bool:
        """Learn from a look, unless ``learn`` is false; False if no filter explains it: then nothing is learned.

        ``heave``: whether its third axis says anything (not at the surface)."""
        b = self._beliefs
        self._predict(look)
        h = self._derivatives(look)
        thrust = np.square(self._effect) @ np.square(look.thrust_n)
        noise = (np.square(b.noise) + b.noise_share**2 * thrust) * (b.independent_s / look.dt_s)
        if not heave:
            noise[2] = UNSEEN
        innovation = look.residual - self._expected(look)
        cross = h @ self._p
        s = cross @ h.transpose(0, 2, 1) + np.diag(noise)
        inverse = np.linalg.inv(s)
        distance2 = np.einsum("ni,nij,nj->n", innovation, inverse, innovation)
        explained = bool(distance2.min() < b.gate)
        if explained and learn:
            gain = cross.transpose(0, 2, 1) @ inverse
            x = self._x + np.einsum("nij,nj->ni", gain, innovation)
            x[:, E] = np.clip(x[:, E], 0.0, 1.5)
            # No sound vehicle is so heavy and so weak as a lost thruster would have it.
            x[:, GAIN] = np.maximum(x[:, GAIN], b.least_gain - x[:, COMMON, None])
            p = self._p - gain @ cross
            self._x, self._p = x, 0.5 * (p + p.transpose(0, 2, 1))
            self._weigh(-0.5 * (distance2 + np.log(np.linalg.det(s))), look.dt_s)
        return explained

    def _weigh(self, told: FloatArray, dt_s: float) -> None:
        """Evidence of a look from the log-likelihoods (n,); stories begin in their time."""
        b = self._beliefs
        gained = np.clip(told[STORIES] - told[0], -b.most[0], b.most[1])
        self._evidence = np.minimum(self._evidence + gained, b.most_evidence)
        self._age_s = self._age_s + dt_s
        self._since_s += dt_s
        if self._since_s >= b.begin_s - 1e-9:
            self._since_s = 0.0
            self._begin_worst()

    def _begin_all(self) -> None:
        """All stories anew; of those that begin at the same time the first is the best."""
        self._evidence, self._age_s = np.zeros(len(STORIES)), np.zeros(len(STORIES))
        self._since_s = 0.0
        for story in range(len(STORIES)):
            self._begin(story)

    def _begin_worst(self) -> None:
        """Of the stories of each thruster and each loss the one that is believed least begins anew, if it is grown."""
        grown = self._age_s >= self._beliefs.grown_s
        believed = np.where(grown, self._evidence, np.inf).reshape(NU, EACH // 2, 2)
        worst = EACH * np.arange(NU)[:, None] + 2 * believed.argmin(axis=1) + np.arange(2)
        self._evidence, self._age_s = self._evidence.copy(), self._age_s.copy()
        for story in worst.ravel():
            if grown[story]:
                self._begin(int(story))

    def _begin(self, story: int) -> None:
        """A story anew: filter 0, with a change of its thruster now."""
        b, thruster = self._beliefs, int(TOLD_OF[story])
        mean, sigma = (1.0, b.sound) if self.lossy[thruster] else (b.half, b.dead)[story % 2]
        here = int(STORIES[story])
        self._x[here], self._p[here] = self._x[0], self._p[0]
        self._set(here, thruster, mean, sigma)
        self._evidence[story] = self._age_s[story] = 0.0

    def _set(self, which: int, thruster: int, mean: float, sigma: float) -> None:
        """Filter ``which`` knows so much of the thruster and no more."""
        self._x[which, thruster] = mean
        self._p[which, thruster, :] = self._p[which, :, thruster] = 0.0
        self._p[which, thruster, thruster] = sigma**2

    def _stationary(self) -> FloatArray:
        """(n, n) covariance of the states that change within seconds."""
        b = self._beliefs
        still = np.zeros(STATES)
        still[PULL], still[MOMENT], still[PUSH] = b.pull_n**2, b.moment**2, np.square(b.push)
        covariance: FloatArray = np.diag(still) + self._waters(b.flow_m_s)
        return covariance

    def _waters(self, sigma_m_s: float) -> FloatArray:
        """(n, n) covariance of an error of the water's velocity, of what drag and the Munk moment feel of it."""
        mean, sigma = self._beliefs.munk
        waters = np.zeros((STATES, STATES))
        waters[FLOW, FLOW] = np.eye(2) * sigma_m_s**2
        waters[FLOW, SWIRL] = waters[SWIRL, FLOW] = np.eye(2) * mean * sigma_m_s**2
        waters[SWIRL, SWIRL] = np.eye(2) * (mean**2 + sigma**2) * sigma_m_s**2
        return waters

    def _predict(self, look: Look) -> None:
        b, dt_s = self._beliefs, look.dt_s
        keep = np.ones(STATES)
        keep[PULL], keep[MOMENT] = math.exp(-dt_s / b.pull_s), math.exp(-dt_s / b.moment_s)
        keep[FLOW] = keep[SWIRL] = math.exp(-dt_s / b.flow_s)
        keep[PUSH] = math.exp(-dt_s / b.push_s)
        x, kept = self._x * keep, np.outer(keep, keep)
        p = self._p * kept + (1.0 - kept) * self._still
        # The same water, against another belief.
        x[:, FLOW] -= look.moved_ned_m_s
        x[:, SWIRL] -= look.moved_ned_m_s
        grow = np.zeros((FILTERS, STATES))
        grow[:, GAIN] = b.gain_wander**2 * dt_s
        lossy = np.tile(self.lossy, (FILTERS, 1))
        lossy[FREE] = True
        lossy[STORIES, TOLD_OF] ^= True
        grow[:, E] = b.wander**2 * dt_s * lossy
        index = np.arange(STATES)
        p[:, index, index] += grow
        self._x, self._p = x, p

    def _expected(self, look: Look) -> FloatArray:
        """(n, 4) residual that each filter expects."""
        x = self._x
        ideal = np.einsum("ij,nj->ni", self._effect, look.thrust_n * x[:, E])
        rate = np.einsum("ij,nj->ni", self._effect, look.thrust_rate_n_s * x[:, E])
        result: FloatArray = self._gain() * ideal - x[:, LAG, None] * rate + x[:, DRAG] * look.drag + x[:, PUSH]
        result += x[:, PULL] @ self._pull(look).T
        result[:, :3] += x[:, FLOW] @ look.flow[:3].T
        result[:, 3] += x[:, SWIRL] @ look.flow[3]
        result[:, [0, 1, 3]] += x[:, TURN] * look.coriolis
        result[:, 3] += x[:, MOMENT] + x[:, ARM] * look.thrust_n[LATERAL]
        return result

    def _derivatives(self, look: Look) -> FloatArray:
        """(n, 4, states) of what is expected."""
        x = self._x
        h = np.zeros((len(x), 4, STATES))
        axes = np.arange(4)
        h[:, :, E] = self._gain()[:, :, None] * (self._effect * look.thrust_n) - x[:, LAG, None, None] * (
            self._effect * look.thrust_rate_n_s
        )
        h[:, axes, 4 + axes] = h[:, :, COMMON] = np.einsum("ij,nj->ni", self._effect, look.thrust_n * x[:, E])
        h[:, axes, 8 + axes] = look.drag
        h[:, [0, 1, 3], [12, 13, 14]] = look.coriolis
        h[:, 3, ARM] = look.thrust_n[LATERAL]
        h[:, :, LAG] = -np.einsum("ij,nj->ni", self._effect, look.thrust_rate_n_s * x[:, E])
        h[:, :, PULL] = self._pull(look)
        h[:, 3, MOMENT] = 1.0
        h[:, :3, FLOW] = look.flow[:3]
        h[:, 3, SWIRL] = look.flow[3]
        h[:, axes, 23 + axes] = 1.0
        return h

    def _gain(self) -> FloatArray:
        """(n, 4) thrust over mass of each axis, 1 = as the vehicle file says."""
        gain: FloatArray = 1.0 + self._x[:, GAIN] + self._x[:, COMMON, None]
        return gain

    def _pull(self, look: Look) -> FloatArray:
        """(4, 3) acceleration per newton of a force NED."""
        c, s = look.north
        pull = np.zeros((4, 3))
        pull[0, :2] = c, s
        pull[1, :2] = -s, c
        pull[2, 2] = 1.0
        per_newton: FloatArray = pull / self._mass[:, None]
        return per_newton
