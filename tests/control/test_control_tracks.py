"""Obstacles that are not in the fence: remembered, taken on, gone round or evaded; and what is no good is dropped."""

import dataclasses
import math

import numpy as np
import pytest
from control_loop import TANK, VEHICLE, A, B, fly, goal

from autopilot.control.constraints.constraints_tuning import TRACKS
from autopilot.control.constraints.tracks import IntendedMotion, Obstructions, Tracks, movers_of
from autopilot.control.controller import MotionController
from autopilot.core.geometry import Fence
from autopilot.core.messages import Fallback
from autopilot.core.samples import ObstacleTrack


def track(
    x: float, y: float, u: float = 0.0, v: float = 0.0, *, t_us: int = 0, number: int = 1, radius_m: float = 0.15
) -> ObstacleTrack:
    return ObstacleTrack(
        t_us=t_us,
        track_id=number,
        pos_ned_m=np.array([x, y]),
        vel_ned_m_s=np.array([u, v]),
        radius_m=radius_m,
    )


def test_a_track_is_taken_on_and_its_circle_grows_with_age() -> None:
    movers = movers_of([track(1.0, 2.0, 0.1, -0.2, t_us=1_000_000)], 3_000_000)
    assert movers is not None
    assert movers.center[0] == pytest.approx(1.2 + 1.6j)
    assert movers.radius_m[0] == pytest.approx(0.15 + 2.0 * TRACKS.growth_m_s)
    assert movers.growth_m_s[0] == TRACKS.growth_m_s
    old = movers_of([track(1.0, 2.0, 0.1)], 10**9)
    assert old is not None
    assert old.radius_m[0] == pytest.approx(0.15 + TRACKS.largest_growth_m)
    assert movers_of([], 0) is None


def test_tracks_are_forgotten_and_bounded() -> None:
    tracks = Tracks()
    tracks.note(0, track(0.0, 0.0, 0.2, number=1))
    tracks.note(0, track(0.0, 0.0, number=2))
    assert [t.track_id for t in tracks.at(TRACKS.forget_moving_us)] == [1, 2]
    assert [t.track_id for t in tracks.at(TRACKS.forget_moving_us + 1)] == [2]
    assert tracks.at(TRACKS.forget_standing_us + 1) == ()
    for number in range(2 * TRACKS.max_tracks):
        tracks.note(number, track(0.0, 0.0, t_us=number, number=number))
    assert [t.track_id for t in tracks.at(2 * TRACKS.max_tracks)] == list(
        range(TRACKS.max_tracks, 2 * TRACKS.max_tracks)
    )
    assert tracks.dropped == 0


@pytest.mark.parametrize(
    "bad",
    [
        {"pos_ned_m": np.array([math.nan, 0.0])},
        {"pos_ned_m": np.array([1e6, 0.0])},
        {"pos_ned_m": np.array([1.0, 0.0, 0.0])},
        {"vel_ned_m_s": np.array([math.inf, 0.0])},
        {"vel_ned_m_s": np.array([30.0, 0.0])},
        {"radius_m": 0.0},
        {"radius_m": -1.0},
        {"radius_m": math.nan},
        {"radius_m": 1e3},
        {"t_us": 2_000_000},
        {"t_us": -1},
        {"t_us": 400_000},
    ],
)
def test_bad_reports_are_counted_and_dropped(bad: dict[str, object]) -> None:
    tracks = Tracks()
    good = track(1.0, 0.0, t_us=500_000)
    tracks.note(1_000_000, good)
    tracks.note(1_000_000, dataclasses.replace(good, **bad))
    assert tracks.dropped == 1
    assert tracks.at(1_000_000) == (good,)


def way(route: list[list[float]], speed_m_s: float = 0.3) -> IntendedMotion:
    return IntendedMotion(route_ned_m=np.array(route), speed_m_s=speed_m_s, goal_distance_m=3.0, keep_m=0.33)


def test_what_stands_enters_the_fence_once_and_what_moves_does_not() -> None:
    sorter, ahead = Obstructions(), way([[0.0, 0.0], [3.0, 0.0]])
    fence, movers = sorter.sort(0, TANK, [], ahead)
    assert fence is TANK
    assert movers is None
    first, movers = sorter.sort(1, TANK, [track(1.0, 0.5), track(2.0, 0.5, 0.2, number=2)], ahead)
    assert len(first.exclusions) == len(TANK.exclusions) + 1
    assert movers is not None
    assert len(movers.center) == 1
    again, _ = sorter.sort(2, TANK, [track(1.02, 0.5)], ahead)
    assert again is first
    moved, _ = sorter.sort(3, TANK, [track(1.2, 0.5)], ahead)
    assert moved is not first
    assert moved.exclusions[-1].center_ned_m == pytest.approx([1.2, 0.5])
    gone, _ = sorter.sort(4, TANK, [], ahead)
    assert gone is TANK


def test_a_mover_that_blocks_the_way_for_long_is_gone_round_for_a_while() -> None:
    sorter = Obstructions()
    waiting = way([[0.0, 0.0], [3.0, 0.0]], speed_m_s=0.01)
    blocker = track(1.0, 0.1, 0.0, 0.05)

    def exclusions(t_us: int, ahead: IntendedMotion = waiting) -> int:
        tracks = [dataclasses.replace(blocker, t_us=t_us)]
        return len(sorter.sort(t_us, TANK, tracks, ahead)[0].exclusions) - len(TANK.exclusions)

    assert exclusions(0) == 0
    assert exclusions(TRACKS.waited_us - 1) == 0
    assert exclusions(TRACKS.waited_us) == 1
    assert exclusions(TRACKS.waited_us + 1_000_000) == 1
    assert exclusions(TRACKS.waited_us + 20_000_000) == 0
    assert exclusions(TRACKS.waited_us + 21_000_000, way([[0.0, 0.0], [3.0, 0.0]], speed_m_s=0.3)) == 0
    assert exclusions(2 * TRACKS.waited_us + 21_000_000, way([[0.0, 0.0], [0.0, 3.0]], speed_m_s=0.0)) == 0


class Seeing(MotionController):
    """Is told at every step of obstacles that move on straight lines, and remembers how near they came."""

    def __init__(self, obstacles: list[ObstacleTrack]) -> None:
        super().__init__(VEHICLE, cpu_clock=lambda: 0.0)
        self.obstacles = obstacles
        self.nearest_m = math.inf

    def step(self, t_us, nav, goal, fence, params, thruster_limit_n=None, tracks=()):  # type: ignore[no-untyped-def]
        now = [
            dataclasses.replace(o, t_us=t_us, pos_ned_m=o.pos_ned_m + o.vel_ned_m_s * t_us * 1e-6)
            for o in self.obstacles
        ]
        for o in now:
            self.nearest_m = min(self.nearest_m, math.dist(o.pos_ned_m, nav.pos_ned_m[:2]) - o.radius_m)
        return super().step(t_us, nav, goal, fence, params, thruster_limit_n, now)


REST = [-1.6, -0.35, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "obstacle",
    [track(0.3, 1.3, 0.0, -0.18), track(2.0, 0.9, -0.3, -0.05), track(-2.2, 0.6, 0.15, 0.0)],
    ids=["crosses", "comes towards", "goes along"],
)
def test_moving_obstacles_are_evaded(obstacle: ObstacleTrack) -> None:
    controller = Seeing([obstacle])
    flight = fly(controller, [B], REST, limit_s=60.0)
    assert len(flight.reached_s) == 1
    assert controller.nearest_m >= VEHICLE.radius_m
    assert flight.wall_distance_m() >= VEHICLE.radius_m
    assert flight.pillar_distance_m() >= VEHICLE.radius_m + 0.16
    assert {o.status.fallback for o in flight.outputs} == {Fallback.NONE}


def test_an_obstacle_that_stands_on_the_way_is_gone_round() -> None:
    """On the straight line, where the half-planes alone would only stop the vehicle."""
    controller = Seeing([track(2.0, 0.0, radius_m=0.3)])
    start = [0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0]
    flight = fly(controller, [goal(4.0, 0.0, 0.4, None)], start, fence=Fence(depth_max_m=1.2), limit_s=30.0)
    assert len(flight.reached_s) == 1
    assert controller.nearest_m >= VEHICLE.radius_m


def test_a_vehicle_that_is_boxed_in_waits_and_goes_on() -> None:
    ring = [
        track(-1.6 + 0.75 * math.cos(a), -0.35 + 0.75 * math.sin(a), number=i, radius_m=0.12)
        for i, a in enumerate(np.arange(0.0, 2.0 * math.pi, math.pi / 5.0))
    ]
    controller = Seeing(ring)
    flight = fly(controller, [A], REST, limit_s=4.0, hold=True)
    assert not controller.unreachable
    flight = fly(controller, [B], REST, limit_s=8.0)
    assert controller.unreachable
    assert controller.nearest_m >= VEHICLE.radius_m
    assert np.abs(flight.x[:, :2] - REST[:2]).max() < 0.1
    controller.obstacles = []
    flight = fly(controller, [B], REST, limit_s=40.0)
    assert len(flight.reached_s) == 1
