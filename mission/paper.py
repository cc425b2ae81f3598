"""The mission of Heshmati-alamdari et al. (ICRA 2018), section IV: tank, obstacles, and the tour A-B-A.

``sitl/scenarios/paper.plan`` is :func:`paper_plan` written to a file, and ``paper.mission.toml`` beside it is the
same in local metres; a test checks that the three agree.
"""

import math

from autopilot.mission.local_plan import (
    CircleTable,
    FenceTable,
    LocalPlan,
    OriginTable,
    PolygonTable,
    RepeatTable,
    WaypointTable,
    plan_of_local,
)
from autopilot.mission.plan_model import PlanFile

LAPS = 3
"""Paper, section IV: the tour was run three times in a row."""
ORIGIN = OriginTable(lat_deg=37.9755, lon_deg=23.7790)
"""A place on the authors' campus; the paper gives only local coordinates. Local zero is the tank's centre."""
ACCEPT_M = 0.3
"""Paper, section IV: reached = inside a ball of 0.3 m."""


def paper_plan(laps: int = LAPS) -> PlanFile:
    """The paper's plan with ``laps`` tours: A, then ``laps`` times B and A again. PlanError if ``laps`` < 1."""
    a = WaypointTable(x_m=-1.60, y_m=-0.35, depth_m=0.45, yaw_rad=0.0, accept_m=ACCEPT_M)
    b = WaypointTable(x_m=1.75, y_m=0.0, depth_m=0.30, yaw_rad=math.pi, accept_m=ACCEPT_M)
    tank = PolygonTable(points_m=[(-2.5, -1.5), (2.5, -1.5), (2.5, 1.5), (-2.5, 1.5)], inclusion=True)
    cylinders = [
        CircleTable(x_m=-0.625, y_m=-0.625, radius_m=0.16),
        CircleTable(x_m=0.9375, y_m=0.0, radius_m=0.16),
    ]
    local = LocalPlan(
        origin=ORIGIN,
        waypoint=[a, b, a],
        repeat=RepeatTable(first_waypoint=1, laps=laps),
        fence=FenceTable(polygon=[tank], circle=cylinders),
    )
    return plan_of_local(local)
