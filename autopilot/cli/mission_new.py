"""``autopilot mission new``: a plan in local metres, for tanks too small for a ground station's map."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.click_types import Finite, OneOf
from autopilot.cli.completion import VEHICLE_NAME
from autopilot.cli.console_output import EXIT_LOSS, emit_json
from autopilot.cli.shared_options import JSON

if TYPE_CHECKING:
    from autopilot.mission.local_plan import WaypointTable

    _NumbersType = click.ParamType[tuple[float, ...]]
else:
    _NumbersType = click.ParamType  # older ones know no type arguments


class Numbers(_NumbersType):
    """Numbers separated by commas (or "x"), with a minimum and a maximum count."""

    name = "numbers"

    def __init__(self, what: str, least: int, most: int | None = None, separator: str = ",") -> None:
        self.what, self.least, self.most, self.separator = what, least, most or least, separator

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        return self.what

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """The numbers; a usage error names the expected form."""
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(part) for part in str(value).lower().split(self.separator))
        except ValueError:
            self.fail(f"{value!r} is not {self.what}", param, ctx)
        if not self.least <= len(numbers) <= self.most or not all(math.isfinite(n) for n in numbers):
            self.fail(f"{value!r} is not {self.what}", param, ctx)
        return numbers


@click.command()
@click.option(
    "--tank", type=Numbers("LENGTHxWIDTH", 2, separator="x"), help="Basin about the origin [m], north x east."
)
@click.option(
    "--obstacle", "obstacles", type=Numbers("X,Y,R", 3), multiple=True, help="Cylinder: north, east, radius [m]."
)
@click.option(
    "--waypoint",
    "waypoints",
    type=Numbers("X,Y,DEPTH[,YAW_DEG]", 3, 4),
    multiple=True,
    help="North, east, depth [m], and a heading; without any a tour of the tank is made.",
)
@click.option("--depth", type=Finite(), default=0.4, show_default=True, metavar="M", help="Of the tour's waypoints.")
@click.option("--laps", default=1, show_default=True, type=click.IntRange(1, 65535), help="How often all is flown.")
@click.option("--end", "end", type=OneOf(["hold", "return", "surface"]), default="hold", show_default=True)
@click.option("--speed", type=Finite(), metavar="M_S", help="Over ground (default: the vehicle's SPD_CRUISE).")
@click.option("--origin", type=Numbers("LAT,LON[,ALT]", 2, 3), help="Of the local frame (default: the parameters').")
@click.option(
    "--vehicle", type=VEHICLE_NAME, default="lbv150", show_default=True, help="Vehicle that the plan is checked for."
)
@click.option("--out", "out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="FILE.plan")
@click.option("--force", is_flag=True, help="Replace FILE.")
@JSON
def new(
    tank: tuple[float, ...] | None,
    obstacles: tuple[tuple[float, ...], ...],
    waypoints: tuple[tuple[float, ...], ...],
    depth: float,
    laps: int,
    end: str,
    speed: float | None,
    origin: tuple[float, ...] | None,
    vehicle: str,
    out: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Write a QGroundControl plan in local metres: tank, obstacles, waypoints.

    QGroundControl draws a tank of 5 m at 130 pixels at most and plans no depth: make the plan here, open it there.
    The origin is the middle of the tank. Exit code 3: written, but a vehicle would not fly it (the reasons are told).
    """
    from autopilot.core.errors import ConfigError
    from autopilot.core.origin_params import params_origin
    from autopilot.core.params import ParamSet
    from autopilot.core.vehicle import load_vehicle
    from autopilot.mission.local_plan import (
        CircleTable,
        EndTable,
        FenceTable,
        LocalPlan,
        OriginTable,
        PolygonTable,
        RepeatTable,
        plan_of_local,
    )
    from autopilot.mission.plan_files import write_plan
    from autopilot.run.plan_verdict import verdict_of

    if out.suffix != ".plan":
        raise ConfigError(f"--out {out}: give a name that ends in .plan")
    if out.exists() and not force:
        raise ConfigError(f"--out {out}: is there already; choose another name, or --force to replace it")
    if tank is None and not waypoints:
        raise ConfigError("there is nothing to plan: give --tank LENGTHxWIDTH, or --waypoint X,Y,DEPTH")
    if tank is not None and not min(tank) > 0.0:
        raise ConfigError(f"--tank {tank[0]:g}x{tank[1]:g}: both lengths have to be positive")
    if any(not circle[2] > 0.0 for circle in obstacles):
        raise ConfigError("--obstacle: the radius has to be positive")
    params, body = ParamSet(), load_vehicle(vehicle)
    radius_m = body.radius_m
    place = params_origin(params)
    lat_deg, lon_deg, alt_m = (*origin, 0.0)[:3] if origin else (place.lat_deg, place.lon_deg, place.alt_m)
    stops = (
        _waypoint_tables(waypoints, speed)
        if waypoints
        else _tour(tank or (0.0, 0.0), obstacles, depth, radius_m, speed)
    )
    corners = _corners(tank) if tank else []
    plan = plan_of_local(
        LocalPlan(
            origin=OriginTable(lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m),
            waypoint=stops,
            repeat=RepeatTable(laps=laps) if laps > 1 else None,
            end=EndTable(action="return" if end == "return" else "surface" if end == "surface" else "hold"),
            fence=FenceTable(
                polygon=[PolygonTable(points_m=corners, inclusion=True)] if corners else [],
                circle=[CircleTable(x_m=x, y_m=y, radius_m=r) for x, y, r in obstacles],
            ),
        ),
        "plan",
    )
    verdict = verdict_of(plan, plan.drawing_origin(), params, body)
    problems = [p.reason for p in (*verdict.own, *verdict.joint)]
    write_plan(out, plan)
    counts = {"mission": len(plan.mission), "fence": len(plan.fence)}
    if as_json:
        emit_json({"file": str(out), **counts, "problems": problems})
    else:
        click.echo(f"{out}: " + ", ".join(f"{name} {count} items" for name, count in counts.items()))
        for reason in problems:
            click.echo(f"not to be flown as it is: {reason}", err=True)
    if problems:
        raise click.exceptions.Exit(EXIT_LOSS)


def _corners(tank: tuple[float, ...]) -> list[tuple[float, float]]:
    """Of the basin, about the origin."""
    north, east = 0.5 * tank[0], 0.5 * tank[1]
    return [(-north, -east), (north, -east), (north, east), (-north, east)]


def _waypoint_tables(waypoints: tuple[tuple[float, ...], ...], speed: float | None) -> list[WaypointTable]:
    """The waypoints of the command line; the speed holds from the first one on."""
    from autopilot.mission.local_plan import WaypointTable

    return [
        WaypointTable(
            x_m=point[0],
            y_m=point[1],
            depth_m=point[2],
            yaw_rad=math.radians(point[3]) if len(point) > 3 else None,
            speed_m_s=speed if n == 0 else None,
        )
        for n, point in enumerate(waypoints)
    ]


def _tour(
    tank: tuple[float, ...],
    obstacles: tuple[tuple[float, ...], ...],
    depth: float,
    radius_m: float,
    speed: float | None,
) -> list[WaypointTable]:
    """Once round the tank near its corners, those left out that an obstacle takes."""
    keep_m = 2.0 * radius_m
    inside = (max(tank[0] - 2.0 * keep_m, 0.0), max(tank[1] - 2.0 * keep_m, 0.0))
    free = [
        (x, y)
        for x, y in dict.fromkeys(_corners(inside))
        if all(math.hypot(x - ox, y - oy) >= r + keep_m for ox, oy, r in obstacles)
    ]
    return _waypoint_tables(tuple((x, y, depth) for x, y in free), speed)
