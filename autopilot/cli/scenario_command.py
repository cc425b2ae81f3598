"""``autopilot scenario``: list, copy and check scenarios, and export their plan with its fence."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.completion import SCENARIO_NAME
from autopilot.cli.console_output import EXIT_LOSS, emit_json, print_table
from autopilot.cli.shared_options import COPY_OUT, JSON, SCENARIO_VEHICLE

if TYPE_CHECKING:
    from autopilot.sitl.scenario_tables import Scenario


@click.group()
def scenario() -> None:
    """Scenario files: check one, write a commented copy, list what is shipped, write the plan with its fence."""


@scenario.command("list")
@JSON
def list_shipped(as_json: bool) -> None:
    """The scenarios that are shipped."""
    from autopilot.sitl.scenario import load_scenario, scenario_names

    known = [load_scenario(name) for name in scenario_names()]
    if as_json:
        emit_json([_plain(each) for each in known])
        return
    print_table(
        "Scenarios (autopilot sitl NAME --start, where there is a plan)",
        ("name", "description", "where", "vehicle", "current", "plan"),
        [
            (p["name"], p["description"], p["where"], p["vehicle"], p["current"], "yes" if p["plan"] else "")
            for p in map(_plain, known)
        ],
    )


def _plain(known: Scenario) -> dict[str, str | int]:
    return {
        "name": known.scenario.name,
        "description": known.scenario.description,
        "where": _where(known),
        "vehicle": known.vehicle.model,
        "current": str(known.current.__struct_config__.tag) + ("" if known.waves is None else ", waves"),
        "plan": known.scenario.plan or "",
        "obstacles": len(known.obstacle),
        "faults": len(known.fault),
        "spread": len(known.spread),
    }


def _where(known: Scenario) -> str:
    tank = known.tank
    if tank is None:
        return "open water"
    north, east = ([corner[axis] for corner in tank.polygon_m] for axis in (0, 1))
    return f"{max(north) - min(north):g} x {max(east) - min(east):g} x {tank.depth_m:g} m"


@scenario.command()
@click.argument("file", type=SCENARIO_NAME)
@SCENARIO_VEHICLE
@JSON
def check(file: str, vehicle: str | None, as_json: bool) -> None:
    """Whether the scenario of FILE (or a shipped name) can be flown: world, start, current, plan and fence.

    Exit code 1, with the reason, if it cannot be simulated or its plan not flown; 3 with remarks.
    """
    from autopilot.run.sitl_check import check_scenario
    from autopilot.sitl.scenario import load_scenario, with_vehicle

    known = load_scenario(file)
    if vehicle is not None:
        known = with_vehicle(known, vehicle, "--vehicle")
    found = check_scenario(file, known)
    if as_json:
        emit_json({**_plain(known), **found.facts, "problems": found.problems, "remarks": found.remarks})
    else:
        print_table(
            f"{known.scenario.name}: {known.scenario.description}", ("what", "value"), list(found.facts.items())
        )
        for kind, texts in (("problem", found.problems), ("remark", found.remarks)):
            for text in texts:
                click.echo(f"{kind}: {text}", err=True)
    if found.problems or found.remarks:
        raise click.exceptions.Exit(1 if found.problems else EXIT_LOSS)


@scenario.command()
@click.argument("name")
@click.option(
    "--from",
    "source",
    type=SCENARIO_NAME,
    default="paper-tank",
    show_default=True,
    help="Shipped scenario or file to copy.",
)
@COPY_OUT
def new(name: str, source: str, out: Path | None) -> None:
    """Write NAME.toml, a commented copy to edit, with its plan and what else it needs beside it."""
    from autopilot.run.sitl_copy import copy_scenario, copy_target

    target = copy_target(name, out)
    for path in copy_scenario(name, source, target):
        click.echo(str(path))
    click.echo(f"edit it, then: autopilot scenario check {target}; autopilot sitl {target} --start")


@scenario.command()
@click.argument("file", type=SCENARIO_NAME)
@click.option("--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="FILE.toml")
@click.option("--force", is_flag=True, help="Replace FILE.")
def markers(file: str, out: Path, force: bool) -> None:
    """Write the marker map of a scenario's floor as the vehicle knows it, for a configuration's place.markers."""
    from autopilot.core.disk import write_result
    from autopilot.core.errors import ConfigError
    from autopilot.core.marker_files import marker_file_text
    from autopilot.sitl.floor import given_markers
    from autopilot.sitl.scenario import load_scenario

    known = load_scenario(file)
    given = given_markers(known)
    if given is None:
        raise ConfigError(f"scenario {known.scenario.name!r} has no [tank], so there is no floor with markers")
    _must_be_new(out, force)
    write_result(out, marker_file_text(given, (f"Floor of the scenario {known.scenario.name}.",)))
    click.echo(f"{out}: {len(given.ids)} markers")


@scenario.command()
@click.argument("file", type=SCENARIO_NAME)
@click.option("--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="FILE.plan")
@click.option("--force", is_flag=True, help="Replace FILE.")
def plan(file: str, out: Path, force: bool) -> None:
    """Write the plan of a scenario, with the fence that it draws, for QGroundControl or autopilot mission upload."""
    from autopilot.core.errors import ConfigError
    from autopilot.mission.plan_files import read_plan, write_plan
    from autopilot.run.sitl_fence import scenario_plan
    from autopilot.sitl.scenario import load_scenario, plan_path

    known = load_scenario(file)
    source = plan_path(file, known)
    if source is None:
        raise ConfigError(f"scenario {known.scenario.name!r} has no plan; name one in scenario.plan")
    _must_be_new(out, force)
    finished, warnings = scenario_plan(read_plan(source), known)
    write_plan(out, finished)
    for text in warnings:
        click.echo(f"warning: {text}", err=True)
    click.echo(f"{out}: mission {len(finished.mission)} items, fence {len(finished.fence)} items")


def _must_be_new(out: Path, force: bool) -> None:
    """ConfigError for a file that is there, without ``force``."""
    from autopilot.core.errors import ConfigError

    if out.exists() and not force:
        raise ConfigError(f"--out {out}: is there already; choose another name, or --force to replace it")
