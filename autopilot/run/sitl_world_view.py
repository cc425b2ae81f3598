"""What the page shows of a simulated world, obstacles and current: as the plant has it, or by the log of a run."""

from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np

from autopilot.core.errors import AutopilotError
from autopilot.core.frames import FloatArray
from autopilot.core.shipped_parts import SHIPPED_PARTS
from autopilot.core.toml_table import Vec2, Vec3
from autopilot.log.reader import Log
from autopilot.sitl.contact import Cylinder, MovingCylinder, Prism, Sphere, moved_to
from autopilot.sitl.current_fields import WithFlow
from autopilot.sitl.scenario_tables import Scenario, Tank
from autopilot.sitl.simulated_waters import build_world
from autopilot.view.page_state import Arrow, FlowView, Solid

ARROWS = 13
"""Arrows of the current along the longer side."""
NEAR_M = 10.0
"""Half the side of the finer grid round the vehicle in open water."""
WIDE_ARROWS, WIDE = 21, 1.6
"""Of the grid over all that the plan shows there: along a side, which is so many times as long, as screens are wide."""


def solid_views(solids: Sequence[Cylinder | Sphere | Prism]) -> tuple[Solid, ...]:
    """Obstacles in the scenario's order."""
    found = []
    for number, solid in enumerate(solids, start=1):
        if isinstance(solid, Prism):
            corners = np.array(solid.polygon_ned_m)
            north, east = corners.mean(axis=0).tolist()
            radius = float(np.hypot(*(corners - (north, east)).T).max())
        else:
            (north, east, *_), radius = solid.center_ned_m, solid.radius_m
        found.append(
            Solid(
                number=number,
                kind=type(solid).__name__.lower(),
                center_m=(north, east),
                depth_m=solid.center_ned_m[2] if isinstance(solid, Sphere) else None,
                radius_m=radius,
                corners_m=tuple(solid.polygon_ned_m) if isinstance(solid, Prism) else (),
            )
        )
    return tuple(found)


def flow_view(
    current_at: Callable[[Vec3, float], Vec3], tank: Tank | None, t_s: float, pos_ned_m: FloatArray, shown_m: FloatArray
) -> FlowView:
    """The current on a grid over the tank; in open water over what the plan shows (n, 2), and finer round the vehicle
    (3,). ``current_at`` gives it [m/s] at a place [m], both NED, and time [s].
    """

    def field(low: FloatArray, high: FloatArray, most: int) -> tuple[Arrow, ...]:
        """On a grid with so many arrows along the longer side."""
        step = float((high - low).max()) / most
        counts = np.maximum(np.round((high - low) / step).astype(int), 1)
        sides = zip(low, high, counts, strict=True)
        norths, easts = ((a + (np.arange(n) + 0.5) * (b - a) / n).tolist() for a, b, n in sides)
        arrows = []
        for north in norths:
            for east in easts:
                u, v, _ = current_at((north, east, float(pos_ned_m[2])), t_s)
                arrows.append((round(north, 3), round(east, 3), round(u, 4), round(v, 4)))
        return tuple(arrows)

    if tank is not None:
        return FlowView(t_s=t_s, arrows=field(np.min(tank.polygon_m, axis=0), np.max(tank.polygon_m, axis=0), ARROWS))
    # Centres on a lattice: the arrows stand still while the vehicle moves.
    step = 2.0 * NEAR_M / ARROWS
    middle = np.round(pos_ned_m[:2] / step) * step
    near = field(middle - NEAR_M, middle + NEAR_M, ARROWS)
    low, high = np.min(shown_m, axis=0), np.max(shown_m, axis=0)
    half = 0.5 * WIDE * float((high - low).max())
    if half <= NEAR_M:
        return FlowView(t_s=t_s, arrows=near)
    step = 2.0 * half / WIDE_ARROWS
    middle = np.round(0.5 * (low + high) / step) * step
    return FlowView(t_s=t_s, arrows=field(middle - half, middle + half, WIDE_ARROWS), near=near)


class LoggedWorld:
    """The world of a run by its scenario and by what its page has changed."""

    def __init__(self, scenario: Scenario) -> None:
        """ConfigError for a world that cannot be built."""
        self._tank, self._waters = scenario.tank, build_world(scenario)

    def solids(self, t_s: float, moved_m: Mapping[int, Vec2]) -> tuple[Solid, ...]:
        """``moved_m``: where obstacles (by number, from 1) have been put."""
        found = []
        for number, solid in enumerate(self._waters.solids, start=1):
            if isinstance(solid, MovingCylinder):
                center_m = solid.path.at(t_s).center_ned_m
                solid = Cylinder(name=solid.name, center_ned_m=center_m, radius_m=solid.radius_m)
            found.append(moved_to(solid, *moved_m[number]) if number in moved_m else solid)
        return solid_views(found)

    def flow(self, t_s: float, pos_ned_m: FloatArray, shown_m: FloatArray, added_m_s: Vec2) -> FlowView:
        """``added_m_s``: flow that the page has added."""
        field = WithFlow(field=self._waters.current, added_m_s=added_m_s)
        return flow_view(field.velocity, self._tank, t_s, pos_ned_m, shown_m)


def logged_world(log: Log) -> tuple[LoggedWorld | None, str]:
    """The simulated world of a log; None of a real vehicle, and with the reason where it cannot be had."""
    data, plant = log.attachments.get("scenario.json"), log.run.get("plant", "")
    if data is None:
        return None, ""
    if plant not in ("", *SHIPPED_PARTS["plant"]):
        return None, f"the plant {plant} has a current of its own"
    try:
        return LoggedWorld(msgspec.json.decode(data, type=Scenario)), ""
    except (msgspec.MsgspecError, AutopilotError) as error:
        return None, f"scenario.json: {error}"
