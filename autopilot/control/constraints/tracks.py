"""Obstacle tracks: extrapolation, ageing, and their use by planner and optimiser.

A track is the position and velocity of a vertical cylinder. It is extrapolated at constant velocity; its radius grows
with its age, and after a timeout it is deleted. Static tracks enter the route planner like exclusions of the fence.
Moving tracks constrain the prediction at their predicted positions, and enter the planner only after the vehicle has
waited for them for long.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.control.constraints.chords import Movers
from autopilot.control.constraints.constraints_tuning import TRACKS
from autopilot.control.constraints.features import BoolArray
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import Goal, NavState
from autopilot.core.samples import ObstacleTrack


class Tracks:
    """The latest word on every obstacle seen."""

    def __init__(self) -> None:
        self._tracks: dict[int, ObstacleTrack] = {}
        self.dropped = 0
        """Rejected reports: not finite, out of range, from the future or older than the track."""
        self.over_m: float | None = None
        """Radius of the largest that the vehicle is deep inside of, None = of none. As of the last :meth:`round`."""

    def note(self, t_us: int, report: ObstacleTrack) -> None:
        """Take note of a report that arrived at ``t_us``."""
        known = self._tracks.get(report.track_id)
        if not _is_sane(t_us, report) or (known is not None and report.t_us < known.t_us):
            self.dropped += 1
            return
        self._tracks[report.track_id] = report
        if len(self._tracks) > TRACKS.max_tracks:
            del self._tracks[min(self._tracks.values(), key=lambda track: (track.t_us, track.track_id)).track_id]

    def forget(self, track_id: int) -> None:
        """It has been seen that there is nothing any more."""
        self._tracks.pop(track_id, None)

    def round(self, t_us: int, pos_ned_m: FloatArray) -> tuple[ObstacleTrack, ...]:
        """:meth:`at` without obstacles that contain the position (3,) deeply, which cannot be avoided any more."""
        kept: list[ObstacleTrack] = []
        over: list[ObstacleTrack] = []
        for track in self.at(t_us):
            moved_m = track.vel_ned_m_s[:2] * (max(0, t_us - track.t_us) * 1e-6)
            off_m = math.hypot(*(pos_ned_m[:2] - track.pos_ned_m[:2] - moved_m).tolist())
            (over if off_m < track.radius_m - TRACKS.deep_m else kept).append(track)
        self.over_m = max((track.radius_m for track in over), default=None)
        return tuple(kept)

    def at(self, t_us: int) -> tuple[ObstacleTrack, ...]:
        """Active tracks at ``t_us``, by track number."""
        for number, track in list(self._tracks.items()):
            if t_us - track.t_us > (TRACKS.forget_standing_us if stands(track) else TRACKS.forget_moving_us):
                del self._tracks[number]
        return tuple(self._tracks[number] for number in sorted(self._tracks))


def stands(track: ObstacleTrack) -> bool:
    """Whether it is taken for one that does not move."""
    return math.hypot(*track.vel_ned_m_s[:2]) < TRACKS.standing_m_s


def movers_of(tracks: Iterable[ObstacleTrack], t_us: int) -> Movers | None:
    """Tracks taken on to ``t_us``; None if there are none."""
    chosen = list(tracks)
    if not chosen:
        return None
    age_s = np.array([max(0, t_us - track.t_us) * 1e-6 for track in chosen])
    velocity = np.array([complex(*track.vel_ned_m_s[:2]) for track in chosen])
    position = np.array([complex(*track.pos_ned_m[:2]) for track in chosen])
    return Movers(
        center=position + velocity * age_s,
        velocity_m_s=velocity,
        radius_m=np.array([track.radius_m for track in chosen])
        + np.minimum(TRACKS.growth_m_s * age_s, TRACKS.largest_growth_m),
        growth_m_s=np.full(len(chosen), TRACKS.growth_m_s),
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class IntendedMotion:
    """Velocity and intended path of the vehicle."""

    speed_m_s: float
    """over ground"""
    route_ned_m: FloatArray
    """(m, 2) remaining part of the last route, first row the vehicle."""
    goal_distance_m: float
    keep_m: float
    """That ways keep from every boundary."""


class Obstructions:
    """Classifies tracks into static ones, for the route planner, and moving ones, for the prediction. One per vehicle;
    deterministic.
    """

    def __init__(self) -> None:
        self._standing: dict[int, Circle] = {}
        self._fence: Fence | None = None
        self._with_them: Fence | None = None
        self.reset()

    def reset(self) -> None:
        """Forget how long the vehicle has waited."""
        self._waits_since_us: int | None = None
        self._detour_until_us = -1
        self._blocking_circles: tuple[Circle, ...] = ()

    @property
    def idle(self) -> bool:
        """Nothing stands, blocks or has been waited for: a step without tracks leaves the fence as it is."""
        return not self._standing and not self._blocking_circles and self._waits_since_us is None

    def go_round(
        self,
        t_us: int,
        fence: Fence,
        tracks: Sequence[ObstacleTrack],
        nav: NavState,
        goal: Goal,
        keep_m: float,
        ahead: Callable[[FloatArray], FloatArray],
    ) -> tuple[Fence, Movers | None]:
        """:meth:`sort` for a vehicle on its way to a goal. ``keep_m``: what routes keep from every boundary; ``ahead``:
        the rest of its route (m, 2) from a place (2,).
        """
        if not tracks and self.idle:
            return fence, None
        here = np.array(nav.pos_ned_m[:2], dtype=float)
        motion = IntendedMotion(
            speed_m_s=math.hypot(*nav.vel_frd_m_s[:2]),
            route_ned_m=ahead(here) if tracks else here[None],
            goal_distance_m=math.hypot(*(goal.pos_ned_m[:2] - here)),
            keep_m=keep_m,
        )
        return self.sort(t_us, fence, tracks, motion)

    def sort(
        self, t_us: int, fence: Fence, tracks: Sequence[ObstacleTrack], motion: IntendedMotion
    ) -> tuple[Fence, Movers | None]:
        """The fence with everything that routes have to go round (the same object while that is the same), and the
        moving obstacles now."""
        changed = self._note_standing([track for track in tracks if stands(track)])
        movers = movers_of([track for track in tracks if not stands(track)], t_us)
        changed |= self._wait(t_us, movers, motion)
        if not self._standing and not self._blocking_circles:
            self._fence = self._with_them = fence
        elif changed or fence is not self._fence or self._with_them is None:
            self._fence = fence
            self._with_them = Fence(
                inclusions=fence.inclusions,
                exclusions=(*fence.exclusions, *self._standing.values(), *self._blocking_circles),
                depth_min_m=fence.depth_min_m,
                depth_max_m=fence.depth_max_m,
            )
        assert self._with_them is not None
        return self._with_them, movers

    def _note_standing(self, tracks: Sequence[ObstacleTrack]) -> bool:
        """Whether the static obstacles have changed enough for a new route."""
        changed = False
        for number in self._standing.keys() - {track.track_id for track in tracks}:
            del self._standing[number]
            changed = True
        for track in tracks:
            known = self._standing.get(track.track_id)
            off = math.inf if known is None else math.hypot(*(track.pos_ned_m[:2] - known.center_ned_m))
            if known is None or off + abs(track.radius_m - known.radius_m) > TRACKS.moved_m:
                self._standing[track.track_id] = Circle(
                    center_ned_m=np.array(track.pos_ned_m[:2], dtype=float), radius_m=track.radius_m
                )
                changed = True
        return changed

    def _wait(self, t_us: int, movers: Movers | None, motion: IntendedMotion) -> bool:
        """Accumulate the time for which moving obstacles block the path. True if the planner's obstacles changed."""
        if self._blocking_circles:
            if t_us < self._detour_until_us and movers is not None:
                return False
            self._blocking_circles = ()
            return True
        blocking = _blocking(movers, motion)
        if (
            movers is None
            or not blocking.any()
            or motion.speed_m_s > TRACKS.waiting_m_s
            or motion.goal_distance_m < motion.keep_m
        ):
            self._waits_since_us = None
            return False
        if self._waits_since_us is None:
            self._waits_since_us = t_us
        if t_us - self._waits_since_us < TRACKS.waited_us:
            return False
        self._waits_since_us, self._detour_until_us = None, t_us + TRACKS.detour_us
        self._blocking_circles = tuple(
            Circle(center_ned_m=np.array([center.real, center.imag]), radius_m=float(radius))
            for center, radius in zip(movers.center[blocking], movers.radius_m[blocking], strict=True)
        )
        return True


def _blocking(movers: Movers | None, motion: IntendedMotion) -> BoolArray:
    """(K,) whether each moving obstacle is on the path now."""
    if movers is None:
        return np.zeros(0, dtype=bool)
    z = np.ascontiguousarray(motion.route_ned_m, dtype=float).view(np.complex128)[:, 0]
    if len(z) == 1:
        z = np.concatenate([z, z])
    a, ab = z[:-1, None], np.diff(z)[:, None]
    fraction = (np.conj(ab) * (movers.center - a)).real / np.maximum(np.abs(ab) ** 2, 1e-12)
    distance = np.abs(movers.center - a - np.clip(fraction, 0.0, 1.0) * ab).min(axis=0)
    result: BoolArray = distance < movers.radius_m + motion.keep_m
    return result


def _is_sane(t_us: int, report: ObstacleTrack) -> bool:
    position, velocity = np.asarray(report.pos_ned_m, dtype=float), np.asarray(report.vel_ned_m_s, dtype=float)
    if position.shape != (2,) or velocity.shape != (2,):
        return False
    numbers = (*position.tolist(), *velocity.tolist(), float(report.radius_m))
    return bool(
        all(math.isfinite(number) for number in numbers)
        and 0.0 < report.radius_m <= TRACKS.largest_radius_m
        and math.hypot(*velocity) <= TRACKS.fastest_m_s
        and math.hypot(*position) <= TRACKS.farthest_m
        and 0 <= report.t_us <= t_us
    )
