"""Effectiveness of each thruster, from pulses and motion.

:mod:`autopilot.control.thrust.filtered_motion` gives the residual of the model ten times per second, and
:mod:`autopilot.control.thrust.loss_bank` the likelihood of a thruster fault against model error, tether, current and
disturbances. Decisions are made here: a fault is declared when its evidence exceeds a threshold and that of every
other thruster by a margin, and revoked on equal evidence for a healthy thruster. Redundant thrusters
(:mod:`autopilot.control.thrust.redundancy`) have equal evidence: where the tilt does not isolate the faulty one, they
are declared together, each with its part of the remaining thrust. The parameters THR1_HEALTH to THR8_HEALTH act at
once; the smaller of parameter and estimate is used.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from autopilot.control.thrust.filtered_motion import MotionFilter
from autopilot.control.thrust.loss_bank import LossBank, Memory
from autopilot.control.thrust.redundancy import TiltEvidence, alike
from autopilot.control.thrust.thrust_tuning import THRUSTER_HEALTH
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import MAX_THRUSTERS, NavHealth, NavState
from autopilot.core.model4 import Model4, steady_force
from autopilot.core.params import ParamSet
from autopilot.core.response import Response

HEALTH_PARAMS = tuple(f"THR{i + 1}_HEALTH" for i in range(MAX_THRUSTERS))
"""Declared by an operator or an ESC's telemetry, in the order of the vehicle file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """Sampling of the updates and thresholds of the decision."""

    filter_s: float = 0.5
    """Time constant that both sides of the model pass: it quietens gyro and velocity, quick against a manoeuvre."""
    interval_s: float = 0.1
    """Interval of updates."""
    current_s: float = 1.0
    """The estimated current is followed within this time."""
    certain: float = 7.7
    """Evidence that a thruster has changed [nats]: two thousand to one."""
    plain: float = 4.5
    """Distance below 1 [sigma] at which a loss of a redundant thruster is significant without a prior on the others."""
    certain_plain: float = 4.5
    """Evidence that is enough then [nats]."""
    ahead: float = 2.0
    """Margin of the evidence over that of any other thruster."""
    settle_s: float = 15.0
    """Timeout of the isolation by tilt."""
    which: float = 6.0
    """Margin of the evidence over that of the redundant thrusters for isolation [nats]."""
    confirm_s: float = 0.5
    """For so long."""
    faulty_below: float = 0.75
    """A thruster with less than this share is lossy."""
    healthy_above: float = 0.9
    """A lossy thruster that gives this share again is sound."""
    follow: float = 0.05
    """A declared value changes when the estimate is further away than this: bounds do not flutter."""
    hit_s: float = 4.0
    """Time after a collision without decisions."""
    stuck_s: float = 15.0
    """Time without an explanation of the motion after which the estimates are reset."""
    seen: float = 0.18
    """Half of a thruster is seen where the effectiveness is known that well (standard deviation)."""


@dataclass(frozen=True, slots=True, eq=False)
class _AmbiguousFault:
    """A fault among redundant thrusters that is not isolated yet."""

    redundant: tuple[int, ...]
    lossy: int
    """That stands for it in the bank."""
    by_s: float
    """When it was declared, on the clock of the tilt's evidence."""
    memory: Memory
    """Snapshot of the bank."""


class ThrusterHealth:
    """Estimate of the effectiveness of all thrusters. :meth:`step` at every tick, deterministic."""

    def __init__(
        self,
        model: Model4,
        response: Response,
        *,
        tilt: FloatArray | None = None,
        submerged_m: float = 0.0,
    ) -> None:
        """Above the depth ``submerged_m`` the hull emerges and heave is not used. ``tilt`` (2, n): roll and pitch
        acceleration per N (:func:`autopilot.control.thrust.redundancy.tilt_of`), None = unknown.
        """
        self._tuning = tuning = Tuning()
        self._submerged_m = submerged_m
        self._bank = LossBank(model)
        self._n = model.thrusters
        # Those that push along several axes are measured against each other; the others have an axis each.
        self._paired = (np.array(model.allocation) != 0.0).sum(axis=0) > 1
        self._redundant = alike(model)
        self._tilt = TiltEvidence(np.zeros((2, self._n)) if tilt is None else tilt)
        self._motion_filter = MotionFilter(
            model, response, filter_s=tuning.filter_s, interval_s=tuning.interval_s, current_s=tuning.current_s
        )
        self._reset_count = -1
        self._paused = True
        self.reset()

    def reset(self) -> None:
        """All thrusters healthy, no evidence."""
        self._bank.reset()
        self._tilt.forget()
        self._past: deque[tuple[Memory, FloatArray, FloatArray, tuple[_AmbiguousFault, ...]]] = deque(
            maxlen=THRUSTER_HEALTH.unlearned_updates
        )
        self._certain_s = np.zeros(self._n)
        self._ambiguous: tuple[_AmbiguousFault, ...] = ()
        self.found = np.ones(self._n)
        """(n,) declared effectiveness: 1 until a fault is certain."""
        self.pause()

    @property
    def faulty(self) -> tuple[bool, ...]:
        """Whether each thruster is declared lossy, alone or as one of several (:attr:`doubtful`)."""
        lossy = list(self._bank.lossy)
        for redundant_one in (redundant_one for fault in self._ambiguous for redundant_one in fault.redundant):
            lossy[redundant_one] = True
        return tuple(lossy)

    @property
    def doubtful(self) -> tuple[tuple[int, ...], ...]:
        """Redundant thrusters with a fault that is not isolated."""
        return tuple(fault.redundant for fault in self._ambiguous)

    @property
    def effectiveness(self) -> FloatArray:
        """(n,) running estimate: of faulty thrusters as declared, of the others without a prior."""
        return np.where(self.faulty, self._shared(self._bank.declared[0]), self._bank.free[0])

    @property
    def sigma(self) -> FloatArray:
        """(n,) its standard deviation."""
        return np.where(self.faulty, self._bank.declared[1], self._bank.free[1])

    @property
    def evidence(self) -> FloatArray:
        """(n,) for a change of each thruster [nats]."""
        return self._bank.evidence

    @property
    def seen(self) -> tuple[bool, ...]:
        """Whether a thruster has been asked for enough that the loss of half of it would show."""
        return tuple((self._bank.sum_sigma(self._redundant) < self._tuning.seen).tolist())

    def pause(self) -> None:
        """Disarmed, or without an estimate: keep the bank, reset the filters of the motion."""
        if not self._paused:
            self._bank.forget_motion()
            self._past.clear()
            self._certain_s = np.zeros(self._n)
        self._motion_filter.forget()
        self._hit_s = self._stuck_s = 0.0
        self._paused = True

    def step(self, t_us: int, nav: NavState, thrust_n: FloatArray) -> bool:
        """``thrust_n`` (n,): steady thrust of healthy thrusters for the pulses since the last call [N].

        True when the declared effectiveness has changed.
        """
        if nav.health is not NavHealth.GOOD or nav.reset_count != self._reset_count:
            self._unlearn()
            self.pause()
            self._reset_count = nav.reset_count
            return False
        motion = self._motion_filter.step(t_us, nav, thrust_n)
        self._paused = False
        if motion is None:
            return False
        if self._hit_s <= 0.0:
            self._past.append((self._bank.memory, self.found, self._certain_s, self._ambiguous))
            self._tilt.update(motion)
        submerged = float(nav.pos_ned_m[2]) > self._submerged_m
        if self._bank.update(motion, heave=submerged, learn=self._hit_s <= 0.0):
            if 0.0 < self._hit_s <= motion.dt_s:
                self._bank.forget_motion(hit=True)
            self._hit_s = max(self._hit_s - motion.dt_s, 0.0)
        else:
            return self._hit(motion.dt_s)
        return self._hit_s <= 0.0 and self._declare(motion.dt_s)

    def _hit(self, dt_s: float) -> bool:
        """Collision or snag: discard the last and the next updates."""
        before = self.found
        if self._hit_s <= 0.0:
            self._unlearn()
            self._stuck_s = 0.0
        self._hit_s = self._tuning.hit_s
        self._stuck_s += dt_s
        if self._stuck_s > self._tuning.stuck_s:
            self._bank.restart_estimates()
            self._stuck_s = 0.0
        return bool((self.found != before).any())

    def _unlearn(self) -> None:
        """Restore the state before the last updates: an estimate degrades before it is flagged."""
        if self._past:
            memory, self.found, self._certain_s, self._ambiguous = self._past[0]
            self._bank.recall(memory)
            self._tilt.forget(len(self._past))
            self._past.clear()

    def _declare(self, dt_s: float) -> bool:
        """Declare all faults above the threshold; True when the declared effectiveness has changed."""
        tuning, bank = self._tuning, self._bank
        self._certain_s = np.where(self._certain(), self._certain_s + dt_s, 0.0)
        best = int(self._certain_s.argmax())
        if self._certain_s[best] >= tuning.confirm_s - 1e-9:
            self._accept(best)
            self._certain_s = np.zeros(self._n)
        if any(bank.lossy):
            e, sigma = bank.declared
            for i in np.flatnonzero(bank.lossy):
                if e[i] - sigma[i] > tuning.healthy_above:
                    bank.clear(int(i))
        self._ambiguous = tuple(fault for fault in self._ambiguous if bank.lossy[fault.lossy])
        if self._tilt.updates % THRUSTER_HEALTH.settled_every == 0:
            self._ambiguous = tuple(fault for fault in self._ambiguous if not self._settled(fault))
        return self._follow(self._shared(np.where(bank.lossy, np.minimum(bank.declared[0], 1.0), 1.0)))

    def _certain(self) -> np.ndarray:
        """(n,) bool, thrusters whose evidence of a change exceeds the threshold."""
        tuning, bank = self._tuning, self._bank
        evidence = bank.evidence
        if float(evidence.max()) <= min(tuning.certain, tuning.certain_plain):  # nearly always
            return np.zeros(self._n, dtype=bool)
        certain = (evidence > self._needed()) & (evidence > self._rivals(evidence) + tuning.ahead)
        certain &= np.array(bank.lossy) | (bank.changed_to < tuning.faulty_below)
        certain &= ~self._open()
        return certain

    def _open(self) -> np.ndarray:
        """(n,) bool, redundant thrusters whose isolation is pending: a second fault among them would be the same
        motion.
        """
        result = np.zeros(self._n, dtype=bool)
        for fault in self._ambiguous:
            if self._tilt.clock_s - fault.by_s < self._tuning.settle_s and self._tilt.tells(fault.redundant):
                result[list(fault.redundant)] = True
        return result

    def _rivals(self, evidence: FloatArray) -> FloatArray:
        """(n,) evidence of the best other hypothesis that is not the same one of a redundant thruster."""
        lossy = np.array(self._bank.lossy)
        same = self._redundant & (lossy[:, None] == lossy)
        result: FloatArray = np.where(same, -np.inf, evidence).max(axis=1, initial=-np.inf)
        return result

    def _accept(self, thruster: int) -> None:
        """Declare the best hypothesis of this thruster, or of the redundant one that is more likely."""
        bank = self._bank
        others = np.where(bank.lossy, bank.declared[0], 1.0)
        redundant = np.flatnonzero(self._redundant[thruster] & ~np.array(bank.lossy))
        if bank.lossy[thruster] or len(redundant) == 1:
            bank.accept(thruster)
            return
        evidence = bank.evidence[redundant] + self._tilt.of(redundant.tolist(), self._tilt.clock_s, others)
        lossy = int(redundant[evidence.argmax()])
        bank.accept(lossy)
        second, first = np.sort(evidence)[-2:]
        if first - second < self._tuning.which:
            fault = _AmbiguousFault(tuple(redundant.tolist()), lossy, self._tilt.clock_s, bank.memory)
            self._ambiguous = (*self._ambiguous, fault)

    def _settled(self, fault: _AmbiguousFault) -> bool:
        """Whether the fault among redundant thrusters is isolated; it is then declared for that one."""
        bank = self._bank
        if sum(bank.lossy[redundant_one] for redundant_one in fault.redundant) > 1:
            return False
        others = np.where(bank.lossy, bank.declared[0], 1.0)
        others[fault.lossy] = 1.0
        evidence = self._tilt.of(fault.redundant, fault.by_s, others)
        second, first = np.sort(evidence)[-2:]
        lossy = fault.redundant[int(evidence.argmax())]
        if first - second < self._tuning.which:
            return False
        if lossy != fault.lossy:
            if bank.lossy == fault.memory.lossy:
                # Updates since then used the wrong one.
                bank.recall(fault.memory)
                bank.forget_motion()
            bank.swap(fault.lossy, lossy)
        return True

    def _shared(self, e: FloatArray) -> FloatArray:
        """(n,) effectiveness with the total of redundant thrusters distributed evenly while a fault is not isolated."""
        shared = e.copy()
        for fault in self._ambiguous:
            redundant = list(fault.redundant)
            shared[redundant] = e[redundant].mean()
        return shared

    def _needed(self) -> FloatArray:
        """(n,) threshold of the evidence: lower where filter 1 also shows the loss."""
        tuning, (e, sigma) = self._tuning, self._bank.free
        plain = self._paired & ~np.array(self._bank.lossy) & (1.0 - e > tuning.plain * sigma)
        return np.where(plain, tuning.certain_plain, tuning.certain)

    def _follow(self, e: FloatArray) -> bool:
        """Update the declared effectiveness where the estimate differs by more than the hysteresis; True on change."""
        far = (np.abs(e - self.found) > self._tuning.follow) | ((e == 1.0) & (self.found < 1.0))
        if not far.any():
            return False
        self.found = np.where(far, e, self.found)
        return True


def configured_effectiveness(params: ParamSet, thrusters: int) -> list[float]:
    """(n,) effectiveness by the parameters."""
    return [params[name] for name in HEALTH_PARAMS[:thrusters]]


def usable(effectiveness: FloatArray) -> FloatArray:
    """(n,) the same with thrusters that are as good as dead set to 0."""
    return np.where(effectiveness < THRUSTER_HEALTH.dead, 0.0, effectiveness)


def hover_problem(
    allocator: ControlAllocator, limit_n: FloatArray, current_ned_m_s: FloatArray, yaw_rad: float | None = None
) -> str:
    """Lost capability of a vehicle with thrust up to ``limit_n`` (n,) in that current, "" if it can keep its position.

    Depth needs heave against the excess buoyancy, heading needs any thruster with an arm, and position needs a heading
    (``yaw_rad``, None = any) at which the thrusters balance drag and Munk moment.
    """
    model = allocator.model
    reach = np.abs(np.array(model.allocation)) @ limit_n
    if reach[2] <= 1.5 * abs(model.buoyancy_excess_n):
        return "depth cannot be held"
    if reach[3] <= 0.0:
        return "heading cannot be held"
    speed, course = math.hypot(*current_ned_m_s[:2]), math.atan2(current_ned_m_s[1], current_ned_m_s[0])
    any_heading = np.linspace(0.0, 2.0 * math.pi, THRUSTER_HEALTH.headings, endpoint=False)
    for drift in any_heading if yaw_rad is None else (course - yaw_rad,):
        # Over ground the vehicle stands, so relative to the water it moves against the current.
        nu = (-speed * math.cos(drift), -speed * math.sin(drift), 0.0, 0.0)
        if allocator.makes(np.array(steady_force(model, nu, math)), limit_n + THRUSTER_HEALTH.short_n):
            return ""
    return f"hover in {speed:.2f} m/s {'is not possible' if yaw_rad is None else 'at this heading is not possible'}"
