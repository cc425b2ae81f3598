"""``autopilot vehicle``: describe a vehicle file, write a template, list the shipped ones."""

from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.console_output import EXIT_LOSS, emit_json, print_table
from autopilot.cli.shared_options import JSON

if TYPE_CHECKING:
    from autopilot.core.vehicle import Vehicle
    from autopilot.core.vehicle_summary import VehicleSummary


def _rows(known: "Vehicle") -> list[dict[str, object]]:
    return [
        {
            "name": thruster.name,
            "channel": thruster.channel,
            "position": ", ".join(f"{value:g}" for value in thruster.position_frd_m),
            "direction": ", ".join(f"{value:.3g}" for value in thruster.direction_frd),
            "limit_n": thruster.limit_n,
            "drive": thruster.drive.kind + (" (reversed)" if thruster.reversed else ""),
        }
        for thruster in known.thrusters
    ]


@click.group()
def vehicle() -> None:
    """Check a vehicle file, write a commented template, list what is shipped."""


@vehicle.command()
@click.argument("file")
@JSON
def check(file: str, as_json: bool) -> None:
    """What the vehicle of FILE (or a shipped name) can do.

    Exit code 1, with the reason, if it cannot be flown; 3 if its tables contradict each other.
    """
    from autopilot.core.vehicle import load_vehicle
    from autopilot.core.vehicle_summary import facts_of

    known = load_vehicle(file)
    facts = facts_of(known)
    if as_json:
        emit_json({"name": known.name, "thrusters": _rows(known), **asdict(facts)})
    else:
        _print(known, facts)
    if facts.contradictions:
        raise click.exceptions.Exit(EXIT_LOSS)


def _print(known: "Vehicle", facts: "VehicleSummary") -> None:
    from autopilot.core.vehicle_summary import CRUISE_M_S

    print_table(
        f"{known.name}: {known.description}",
        ("thruster", "channel", "position [m]", "pushes", "limit [N]", "drive"),
        [[f"{cell:g}" if isinstance(cell, float) else cell for cell in row.values()] for row in _rows(known)],
    )
    print_table(
        "Axes",
        ("axis", "authority", "unit", "steady speed", "unit of speed"),
        [
            (each.axis, f"{each.authority:.2f}", force, f"{each.speed:.2f}", speed)
            for each in facts.axes
            for force, speed in ((("N m", "rad/s") if each.axis == "yaw" else ("N", "m/s")),)
        ],
    )
    click.echo(f"hover {facts.hover_w:.1f} W, ahead at {CRUISE_M_S:g} m/s {facts.cruise_w:.1f} W")
    tilts = " and ".join(facts.tilts)
    if tilts:
        click.echo(
            f"{tilts} can be pushed" + (": levelled in flight" if known.levelling else "; add [levelling] to level it")
        )
    else:
        click.echo("roll and pitch are left to the buoyancy")
    for line in facts.missing:
        click.echo(f"missing: {line}")
    for line in facts.contradictions:
        click.echo(f"warning: {line}", err=True)


@vehicle.command("list")
@JSON
def list_shipped(as_json: bool) -> None:
    """The vehicles that are shipped."""
    from autopilot.core.vehicle import load_vehicle, vehicle_names

    known = [load_vehicle(name) for name in vehicle_names()]
    if as_json:
        emit_json([{"name": each.name, "description": each.description} for each in known])
        return
    print_table("Vehicles", ("name", "description"), [(each.name, each.description) for each in known])


@vehicle.command()
@click.argument("name")
@click.option("--out", type=click.Path(dir_okay=False), help="File to write (default: NAME.toml).")
def new(name: str, out: str | None) -> None:
    """Write a commented vehicle file to edit."""
    from autopilot.run.sitl_copy import check_file_name, write_copies

    check_file_name(name)
    target = Path(out or f"{name}.toml")
    text = (resources.files("autopilot") / "data" / "templates" / "vehicle.toml").read_text(encoding="utf-8")
    write_copies({target: text.replace('name = "NAME"', f'name = "{name}"', 1).encode()}, target.parent)
    click.echo(f"{target}: edit it, then autopilot vehicle check {target}")
