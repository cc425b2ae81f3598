"""Draws a .plan as QGroundControl has it and as the vehicle takes it: ``python docs/plan_picture.py [PLAN] [PNG]``.

Without arguments the paper's plan, to docs/figures/qgc_plan.png. Left: what the ground station draws (items from
1, altitudes negative, shapes as they are). Right: what is flown, in metres of the local frame (items from 0, depths,
the body's radius and margin round every shape).
"""

import sys
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from autopilot.core.geodesy import ned_from_geodetic, place_from_ned
from autopilot.mission.plan_files import read_plan
from autopilot.mission.plan_model import PlanFile

PAGE = Path(__file__).resolve().parent
PAPER = PAGE.parent / "sitl" / "scenarios" / "paper.plan"
KEPT_M = 0.33
"""Body radius of the LBV150 and MPC_MARGIN."""
POSITIONED = (16, 17, 19, 21, 22)
INCLUSION, EXCLUSION, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004
FENCE, ZONE, WAY = "#1f7a1f", "#c03030", "#1f4e79"

Place = tuple[float, float]


def shapes(plan: PlanFile) -> tuple[list[tuple[list[Place], bool]], list[tuple[Place, float, bool]]]:
    """Polygons and circles of the fence in degrees, each with whether the vehicle stays inside."""
    polygons: list[tuple[list[Place], bool]] = []
    circles: list[tuple[Place, float, bool]] = []
    corners: list[Place] = []
    for item in plan.fence:
        at = (item.x / 1e7, item.y / 1e7)
        if item.command in (CIRCLE_IN, CIRCLE_OUT):
            circles.append((at, item.param1, item.command == CIRCLE_IN))
            continue
        corners.append(at)
        if len(corners) == round(item.param1):
            polygons.append((corners, item.command == INCLUSION))
            corners = []
    return polygons, circles


def draw(path: Path, target: Path) -> None:
    plan = read_plan(path)
    assert plan.home is not None, f"{path} has no home"
    home = plan.home
    polygons, circles = shapes(plan)
    ways = [item for item in plan.mission if item.command in POSITIONED]

    def metres(place: Place) -> Place:
        north, east, _ = ned_from_geodetic(home, *place, home.alt_m).tolist()
        return float(north), float(east)

    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)

    def at(place: Place) -> Place:
        """East to the right, north up; degrees are drawn in metres and labelled in degrees."""
        north, east = metres(place)
        return (east, north)

    for axes, local in ((left, False), (right, True)):
        for corners, inside in polygons:
            colour = FENCE if inside else ZONE
            axes.add_patch(Polygon([at(corner) for corner in corners], fill=not inside, alpha=1.0 if inside else 0.4,
                                   facecolor=colour, edgecolor=colour, linewidth=2.0, closed=True))  # fmt: skip
        for centre, radius_m, inside in circles:
            colour = FENCE if inside else ZONE
            axes.add_patch(Circle(at(centre), radius_m, facecolor=colour, edgecolor=colour, alpha=0.4, fill=not inside))
            if local and not inside:
                axes.add_patch(Circle(at(centre), radius_m + KEPT_M, fill=False, edgecolor=colour, linestyle="--"))
        track = [at((item.x / 1e7, item.y / 1e7)) for item in ways]
        axes.plot(*zip(*track, strict=True), color=WAY, linewidth=1.2, linestyle=":" if local else "-")
        names: dict[Place, str] = {}
        for item, place in zip(ways, track, strict=True):
            what = f"depth {-item.z:g} m" if local else f"altitude {item.z:g} m"
            number = f"{item.seq if local else item.seq + 1}"
            names[place] = f"{number}: {what}" if place not in names else f"{number}, {names[place]}"
        for place, name in names.items():
            axes.plot(*place, "o", color=WAY, markersize=6)
            axes.annotate(name, place, xytext=(0, 9), textcoords="offset points", ha="center", fontsize=9)
        axes.set_aspect("equal")
        axes.autoscale_view()
    _label(left, home)
    left.set_title("as the ground station draws it", fontsize=11)
    right.set_title("as it is flown (dashed: bound of the vehicle's centre)", fontsize=11)
    left.set_xlabel("longitude [deg]")
    left.set_ylabel("latitude [deg]")
    right.set_xlabel("east [m]")
    right.set_ylabel("north [m]")
    FigureCanvasAgg(figure)
    figure.savefig(target, dpi=110, metadata={"Software": None})


def _label(axes: Any, home: Any) -> None:
    """Latitude and longitude in place of metres."""
    for axis, north in ((axes.yaxis, True), (axes.xaxis, False)):

        def degrees(metre: float, _: int, north: bool = north) -> str:
            place = place_from_ned(home, metre if north else 0.0, 0.0 if north else metre, 0.0)
            return "" if place is None else f"{place.lat_deg if north else place.lon_deg:.5f}"

        axis.set_major_formatter(degrees)
        axis.set_major_locator(_every(1.0))
    axes.tick_params(labelsize=8, axis="x", rotation=30)
    axes.tick_params(labelsize=8, axis="y")


def _every(metres: float) -> Any:
    from matplotlib.ticker import MultipleLocator

    return MultipleLocator(metres)


if __name__ == "__main__":
    given = [Path(name) for name in sys.argv[1:]]
    draw(given[0] if given else PAPER, given[1] if given[1:] else PAGE / "figures" / "qgc_plan.png")
