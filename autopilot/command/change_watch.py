"""Notices of changes that the operator did not request: position lost or found, no path to the goal, a new fence."""

from autopilot.command.command_tuning import WATCH
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.control.thrust.redundancy import lossy_effectiveness
from autopilot.core import operator_messages as notices
from autopilot.core.messages import NavDoubt, NavHealth, NavState
from autopilot.core.operator_messages import OperatorText
from autopilot.core.vehicle import Vehicle
from autopilot.mission.goals import Goals
from autopilot.mission.store import Plans

_HEALTH_TEXTS = {
    NavHealth.GOOD: notices.POSITION_GOOD,
    NavHealth.DEAD_RECKONING: notices.DEAD_RECKONING,
    NavHealth.INVALID: notices.POSITION_LOST,
}

DOUBT_TEXTS = {
    NavDoubt.ACCELEROMETER: notices.ACCELEROMETER_WRONG,
    NavDoubt.GYRO: notices.GYRO_WRONG,
    NavDoubt.FIXES: notices.FIXES_DISAGREE,
    NavDoubt.RANGE: notices.RANGE_DISAGREES,
    NavDoubt.MAP: notices.MAP_DISAGREES,
    NavDoubt.CALIBRATION: notices.CALIBRATION_SUSPECT,
    NavDoubt.RESETS: notices.REPEATED_RESETS,
    NavDoubt.CAMERA: notices.CAMERA_WRONG,
    NavDoubt.DEPTH: notices.DEPTH_DISAGREES,
}
"""Remedy for a sensor that contradicts the other evidence."""

_HEALTH_TEXTS_POSES = _HEALTH_TEXTS | {
    NavHealth.DEAD_RECKONING: notices.DEAD_RECKONING_POSES,
    NavHealth.INVALID: notices.POSITION_LOST_POSES,
}

DOUBT_TEXTS_POSES = DOUBT_TEXTS | {
    NavDoubt.ACCELEROMETER: notices.ACCELEROMETER_WRONG_POSES,
    NavDoubt.GYRO: notices.GYRO_WRONG_POSES,
    NavDoubt.FIXES: notices.POSES_DISAGREE,
    NavDoubt.RANGE: notices.POSE_RANGE_DISAGREES,
    NavDoubt.CALIBRATION: notices.POSE_LATENCY_SUSPECT,
    NavDoubt.RESETS: notices.REPEATED_RESETS_POSES,
    NavDoubt.CAMERA: notices.POSES_WRONG,
}
"""The same where the position comes from a source of poses and nobody has markers."""


_SYMPTOMS = (NavDoubt.FIXES, NavDoubt.ACCELEROMETER)


class ChangeWatch:
    """Reports changes since the last tick."""

    def __init__(self, vehicle: Vehicle, plans: Plans, goals: Goals, *, has_markers: bool = True) -> None:
        """``has_markers``: whether the position comes from markers, not from another source of poses."""
        self._health_texts = _HEALTH_TEXTS if has_markers else _HEALTH_TEXTS_POSES
        self._doubt_texts = DOUBT_TEXTS if has_markers else DOUBT_TEXTS_POSES
        self._radius_m = vehicle.radius_m
        self._plans = plans
        self._goals = goals
        self._fence = goals.fence
        self._health = NavHealth.INVALID
        self._reported_doubts: frozenset[NavDoubt] = frozenset()
        """Reported since arming."""
        self._held_us: dict[NavDoubt, int] = {}
        """Symptoms and since when: their cause may yet be found."""
        self._unreachable = False
        self._thrusters = tuple(thruster.name for thruster in vehicle.thrusters)
        self._reported_effectiveness: dict[str, float] = {}
        self._last_effectiveness: tuple[float, ...] | None = None
        self._doubtful: tuple[tuple[str, ...], ...] = ()
        self._armed_us: int | None = None
        self._delay_s = 0.0

    def update(self, status: VehicleStatus, *, armed: bool) -> list[OperatorText]:
        nav = status.nav
        texts: list[OperatorText] = []
        health = NavHealth.INVALID if nav is None else nav.health
        new = self._new_doubts(status) if armed else frozenset()
        texts += [self._doubt_texts[doubt]() for doubt in NavDoubt if doubt in new] if new else []
        self._reported_doubts = self._reported_doubts | new if armed else frozenset()
        if not armed:
            self._held_us.clear()
        # The text of that warning already says why the fixes are rejected; with fixes another sensor is at fault.
        told = bool(new or self._held_us) or NavDoubt.FIXES in status.nav_doubts or status.fixed
        reported = health is NavHealth.DEAD_RECKONING and told
        if armed and health is not self._health and not reported:
            texts.append(self._health_texts[health]())
        if armed and status.unreachable and not self._unreachable:
            texts.append(notices.NO_FREE_PATH())
        texts += self._of_commands(status.command_delay_s) if armed else []
        self._health, self._unreachable = health, status.unreachable
        texts += self._of_redundant(status.thruster_effectiveness, status.thrusters_doubtful)
        texts += self._of_thrusters(status.thruster_effectiveness)
        texts += self._of_flight(status, armed)
        if self._goals.fence is not self._fence:
            self._fence = self._goals.fence
            texts += self._of_fence(nav if armed and health is not NavHealth.INVALID else None)
        return texts

    def _new_doubts(self, status: VehicleStatus) -> frozenset[NavDoubt]:
        """Doubts to be reported: that fixes disagree only if no doubt says why within a while, an accelerometer only if
        it is no blow that it has felt.
        """
        new = status.nav_doubts - self._reported_doubts
        for doubt in _SYMPTOMS:
            if doubt in new:
                self._held_us.setdefault(doubt, status.t_us)
            since_us = self._held_us.get(doubt)
            if since_us is None:
                continue
            new -= {doubt}
            why = status.nav_doubts - {doubt} if doubt is NavDoubt.FIXES else frozenset()
            struck = doubt is NavDoubt.ACCELEROMETER and status.collided_us >= since_us - WATCH.jolt_us
            hold_us = WATCH.cause_us if doubt is NavDoubt.FIXES or struck else WATCH.jolt_us
            if why:
                self._reported_doubts |= {doubt}
            elif status.t_us - since_us >= hold_us:
                new |= {doubt} if doubt in status.nav_doubts or not struck else frozenset()
            else:
                continue
            del self._held_us[doubt]
        return new

    def _of_commands(self, delay_s: float) -> list[OperatorText]:
        """Commands that act late, or again at once."""
        reported_s = self._delay_s
        if abs(delay_s - reported_s) < WATCH.delay_news_s and not (delay_s == 0.0 != reported_s):
            return []
        self._delay_s = delay_s
        if delay_s == 0.0:
            return [notices.LATENCY_NORMAL()]
        return [notices.LATENCY(delay_s=delay_s)]

    def _of_redundant(
        self, effectiveness: tuple[float, ...], doubtful: tuple[tuple[str, ...], ...]
    ) -> list[OperatorText]:
        """One of several thrusters that do the same gives less than it should, or none of them any more."""
        if doubtful == self._doubtful:
            return []
        effectiveness_of = dict(zip(self._thrusters, effectiveness, strict=False))
        texts: list[OperatorText] = []
        for group in doubtful:
            if group not in self._doubtful:
                left = 100.0 * lossy_effectiveness([effectiveness_of[name] for name in group])
                texts.append(notices.REDUNDANT_LOSS(names=", ".join(group), percent=left))
        restored = [
            group
            for group in self._doubtful
            if group not in doubtful and all(effectiveness_of[t] == 1.0 for t in group)
        ]
        texts += [notices.REDUNDANT_RESTORED(names=", ".join(group)) for group in restored]
        self._doubtful = doubtful
        return texts

    def _of_thrusters(self, effectiveness: tuple[float, ...]) -> list[OperatorText]:
        """Loss of effectiveness of a thruster, or its recovery."""
        texts: list[OperatorText] = []
        if effectiveness == self._last_effectiveness:
            return texts
        self._last_effectiveness = effectiveness
        for name, value in zip(self._thrusters, effectiveness, strict=False):
            if any(name in group for group in self._doubtful):
                continue
            reported = self._reported_effectiveness.get(name, 1.0)
            if abs(value - reported) < WATCH.effectiveness_news and not (value == 1.0 != reported):
                continue
            self._reported_effectiveness[name] = value
            if value == 1.0:
                texts.append(notices.THRUSTER_RESTORED(name=name))
            else:
                texts.append(notices.THRUSTER_LOSS(name=name, percent=100.0 * value))
        return texts

    def _of_flight(self, status: VehicleStatus, armed: bool) -> list[OperatorText]:
        """After a flight: a thruster that was hardly used has not been verified."""
        since_us = self._armed_us
        self._armed_us = (status.t_us if since_us is None else since_us) if armed else None
        if armed or since_us is None or status.t_us - since_us < WATCH.flight_us or not status.thrusters_unseen:
            return []
        return [notices.THRUSTERS_UNJUDGED(names=", ".join(status.thrusters_unseen))]

    def _of_fence(self, nav: NavState | None) -> list[OperatorText]:
        """Narrow gaps, and a vehicle that the new fence finds where it must not be."""
        texts = [notices.FENCE_GAP(text=text) for text in self._plans.warnings()]
        lack_m = 0.0 if nav is None else self._radius_m - self._goals.clearance_m(nav.pos_ned_m)
        if lack_m > 0.0:
            texts.append(notices.FENCE_TOO_NEAR(lack_m=lack_m))
        return texts
