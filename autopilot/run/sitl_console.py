"""Console output of a SITL run: messages to the operator, and events of the simulation.

Contacts and obstacles outside the fence are reported by the simulated world; the service does not know them.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Outputs, ProgressState, RunEnd
from autopilot.core.plan import PlanKind
from autopilot.core.shapes import clearance_m
from autopilot.core.toml_table import Vec2
from autopilot.run.console import EventLines, Print
from autopilot.run.sitl_session import SitlSession
from autopilot.sitl.scenario_tables import CylinderObstacle, MovingObstacle, Obstacle, PrismObstacle, Scenario

KNOWN_M = 0.02
"""Tolerance: a fence comes over the wire on a grid of 11 mm."""
RIM_POINTS = 24


class RunWatch:
    """Follows a run tick by tick: lines for the console, contacts, and whether the mission is complete."""

    def __init__(self, session: SitlSession, show: Print) -> None:
        self._session = session
        self._lines = EventLines(show)
        self._armed = self._was_active = False
        self._looked_at: int | None = None
        self.contacts = 0
        """Contacts so far."""
        self.complete = False
        """The mission has been complete."""
        self.over = False
        """Nothing will complete it any more: the operator in this process does not start it twice."""

    def step(self, outputs: Outputs) -> None:
        self._lines.step(outputs)
        self._report_contacts(outputs.t_us)
        armed, begins = outputs.mode.armed, outputs.mode.armed and not self._armed
        self._check_fence(outputs.t_us, arming=begins)
        state = None if outputs.progress is None else outputs.progress.state
        self._was_active |= armed and state is ProgressState.ACTIVE
        self.complete |= self._was_active and state is ProgressState.COMPLETE
        self.over |= self._was_active and not armed and self._session.world.operator is not None
        self._armed = armed

    @property
    def run_end(self) -> RunEnd | None:
        """How an operator has ended the run."""
        return self._lines.run_end

    @property
    def ended(self) -> bool:
        """Whether a run that is to end with its mission ends now."""
        return self.complete or self.over

    def _report_contacts(self, t_us: int) -> None:
        truth = self._session.device.truth
        if truth.contact_count > self.contacts:
            self.contacts = truth.contact_count
            x, y, z = truth.pos_ned_m
            depth_mm = 1e3 * truth.contact_depth_m
            self._lines.line(
                t_us, f"! Contact {self.contacts}: {depth_mm:.0f} mm at north {x:.2f}, east {y:.2f}, depth {z:.2f} m"
            )

    def _check_fence(self, t_us: int, *, arming: bool) -> None:
        """Report obstacles of the scenario that the fence does not contain: with every fence, and at arming at the
        latest. Clients send the mission before its fence."""
        plans = self._session.parts.plans
        if plans.revision == self._looked_at:
            return
        if arming or plans.items(PlanKind.FENCE):
            self._looked_at = plans.revision
            for text in unknown_obstacles(self._session.world.scenario, self._session.parts.commander.fence):
                self._lines.line(t_us, f"! {text}")


def unknown_obstacles(scenario: Scenario, fence: Fence) -> tuple[str, ...]:
    """Obstacles of the scenario inside the permitted area of the fence, one line each."""
    texts = []
    for number, obstacle in enumerate(scenario.obstacle, start=1):
        where = _outline(obstacle)
        if _reachable(where, fence).any():
            x, y = np.round(where.mean(axis=0), 2) + 0.0  # no -0.00
            sensed = isinstance(obstacle, MovingObstacle) or (
                isinstance(obstacle, CylinderObstacle) and obstacle.surprise
            )
            text = "only the obstacle sensor may tell of it" if sensed else "the vehicle does not know it, add it"
            texts.append(f"Obstacle {number} at north {x:.2f}, east {y:.2f} m is not in the fence: {text}")
    if scenario.tank is not None and _reachable(_walls(scenario.tank.polygon_m), fence).any():
        texts.append("The tank's walls are not in the fence: draw the area in which the vehicle may go")
    return tuple(texts)


def _walls(polygon_m: Sequence[Vec2]) -> FloatArray:
    """(n, 2) points of the walls."""
    corners = np.array([*polygon_m, polygon_m[0]])
    return np.vstack([a + np.linspace(0.0, 1.0, RIM_POINTS)[:, None] * (b - a) for a, b in pairwise(corners)])


def _outline(obstacle: Obstacle) -> FloatArray:
    """(n, 2) points of an obstacle's rim and inside, of a moving one along its path."""
    if isinstance(obstacle, PrismObstacle):
        return _walls(obstacle.polygon_m)
    angles = np.linspace(0.0, 2.0 * np.pi, RIM_POINTS, endpoint=False)
    rim = obstacle.radius_m * np.column_stack((np.cos(angles), np.sin(angles)))
    disc = np.vstack((rim, 0.5 * rim, np.zeros((1, 2))))
    if not isinstance(obstacle, MovingObstacle):
        return np.asarray(disc + np.array(obstacle.center_m[:2]), dtype=np.float64)
    corners = np.array(obstacle.path_m)
    steps: Sequence[FloatArray] = [
        a + fraction * (b - a) for a, b in pairwise(corners) for fraction in np.linspace(0.0, 1.0, RIM_POINTS)
    ]
    return np.vstack([disc + step for step in steps])


def _reachable(points: FloatArray, fence: Fence) -> FloatArray:
    """(n,) which of these points lie outside the forbidden area by more than the fence's tolerance."""
    open_ = np.ones(len(points), dtype=bool)
    for shape in fence.exclusions:
        open_ &= clearance_m(shape, points) > KNOWN_M
    for shape in fence.inclusions:
        open_ &= clearance_m(shape, points) < -KNOWN_M
    return np.asarray(open_)
