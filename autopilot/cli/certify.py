"""``autopilot certify``: margins of the controller to every limit, and verified goals of a plan."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.completion import VEHICLE_NAME
from autopilot.cli.console_output import emit_json, print_table
from autopilot.cli.shared_options import JSON

if TYPE_CHECKING:
    from autopilot.core.frames import FloatArray
    from autopilot.core.geometry import Fence
    from autopilot.core.messages import Goal
    from autopilot.core.params import ParamSet
    from autopilot.core.vehicle import Vehicle

SAMPLES, SHORT_SAMPLES = 20_000, 2_000
MOST_M_S = 10.0
"""Of a current: no tide is faster."""
CURRENTS = ("0,0", "0.15,0", "0,0.15", "-0.25,0", "0,-0.3")


@click.command()
@click.argument("plan", type=click.Path(path_type=Path), required=False)
@click.option(
    "--vehicle", type=VEHICLE_NAME, default="lbv150", show_default=True, help="Vehicle file or shipped vehicle."
)
@click.option("--param", "overrides", multiple=True, metavar="NAME=VALUE", help="With another parameter value.")
@click.option("--current", "currents", multiple=True, metavar="NORTH,EAST", help="Current [m/s]; several may be given.")
@click.option("--short", is_flag=True, help="2,000 samples instead of 20,000, short flights.")
@JSON
def certify(
    plan: Path | None,
    vehicle: str,
    overrides: tuple[str, ...],
    currents: tuple[str, ...],
    short: bool,
    as_json: bool,
) -> None:
    """Margins of the prediction and terminal certificates for PLAN (default: the paper's).

    tube: what is kept from every limit along the horizon, for several qualities of the estimate.
    lipschitz: growth of the open-loop bound, and from which node on the tightened sets are empty.
    certificates: terminal region of every waypoint in several currents, verified by sampling the nonlinear model.
    munk: heading while cruising, with and without the feedback between steps of the optimiser.
    cost: what all this takes of a control step.
    """
    from autopilot.analysis.munk import bench_munk
    from autopilot.analysis.plan_margins import certificate_table, cost_table, lipschitz_table, tube_table
    from autopilot.core.params import ParamSet
    from autopilot.core.vehicle import load_vehicle
    from autopilot.mission.reach import widest_m
    from autopilot.run.config import parse_overrides

    params, body = ParamSet(parse_overrides(overrides)), load_vehicle(vehicle)
    goals, fence = _goals(plan, params, body)
    flows = [_current(text) for text in currents or CURRENTS]
    free_m = widest_m(fence) - body.radius_m
    results: dict[str, Sequence[Any]] = {
        "tube": tube_table(body, params),
        "lipschitz": lipschitz_table(body, params, free_m),
        "certificates": certificate_table(body, params, goals, fence, flows, SHORT_SAMPLES if short else SAMPLES),
        "munk": bench_munk(8.0 if short else 20.0),
        "cost": cost_table(body, goals[0], fence, 40 if short else 300),
    }
    tables = {name: [asdict(row) for row in rows] for name, rows in results.items()}
    if as_json:
        emit_json(tables)
        return
    for name, rows in tables.items():
        columns = [column for column in rows[0] if column != "text"] if rows else []
        print_table(TITLES[name], columns, [[_figure(row[column]) for column in columns] for row in rows])
    for row in tables["certificates"]:
        if not row["fits"] or row["alpha"] <= 0.0:
            click.echo(f"item {row['item']} in {row['current_n_e_m_s']} m/s: {row['text']}")


TITLES = {
    "tube": "Tube: what is kept from every limit; clearance at 0.1, 1.3 and 7 s ahead, the others at the end",
    "lipschitz": "Lipschitz growth of the open-loop prediction (MPC_TIGHTEN 2)",
    "certificates": "Terminal regions, decrease sampled on the nonlinear model",
    "munk": "Yaw-sway instability near 0.5 m/s with a random moment and side force",
    "cost": "CPU time of a control step; shares of it in the same run",
}


def _goals(path: Path | None, params: "ParamSet", vehicle: "Vehicle") -> "tuple[list[Goal], Fence]":
    """Waypoints of a plan (without duplicates) and its fence. PlanError if there is none or it fails the checks."""
    from autopilot.core.errors import PlanError
    from autopilot.core.messages import Goal
    from autopilot.mission.items import GoTo
    from autopilot.mission.paper import paper_plan
    from autopilot.mission.plan_files import read_plan
    from autopilot.mission.store import Plans, load_plan

    plan = paper_plan() if path is None else read_plan(path)
    name = "the paper's plan" if path is None else str(path)
    plans = Plans(params, vehicle.radius_m, plan.drawing_origin())
    problem = load_plan(plans, plan, name)
    if problem:
        raise PlanError(f"{name}: {problem}")
    goals: dict[tuple[float, ...], Goal] = {}
    for step in plans.steps():
        if isinstance(step, GoTo) and step.pos_ned_m is not None:
            goals.setdefault(
                tuple(step.pos_ned_m.round(2).tolist()),
                Goal(
                    pos_ned_m=step.pos_ned_m,
                    yaw_rad=step.yaw_rad,
                    speed_m_s=params["SPD_CRUISE"],
                    accept_radius_m=step.accept_radius_m or params["WP_ACCEPT_RADIUS"],
                    accept_yaw_rad=params["WP_ACCEPT_YAW"],
                    seq=step.seq,
                ),
            )
    if not goals:
        raise PlanError(f"{name}: has no waypoint; draw at least one")
    return list(goals.values()), plans.fence()


def _current(text: str) -> "FloatArray":
    import numpy as np

    try:
        north, east = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is no current; give NORTH,EAST in m/s, as 0.15,-0.1") from None
    if not math.hypot(north, east) <= MOST_M_S:
        raise click.BadParameter(f"{text!r} is no current; give NORTH,EAST in m/s, {MOST_M_S:g} m/s together at most")
    return np.array([north, east, 0.0])


def _figure(value: object) -> str:
    if isinstance(value, tuple):
        return " ".join(f"{x:.3f}" for x in value)
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)
