"""``autopilot vehicle``: describe a vehicle file, write a template, list the shipped ones."""

from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.console_output import emit_json, print_table
from autopilot.cli.shared_options import JSON

if TYPE_CHECKING:
    from autopilot.core.vehicle import Vehicle


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    name: str
    channel: int
    position: str
    direction: str
    limit_n: float
    drive: str


def _rows(known: "Vehicle") -> list[_Row]:
    return [
        _Row(
            name=thruster.name,
            channel=thruster.channel,
            position=", ".join(f"{value:g}" for value in thruster.position_frd_m),
            direction=", ".join(f"{value:.3g}" for value in thruster.direction_frd),
            limit_n=thruster.limit_n,
            drive=thruster.drive.kind + (" (reversed)" if thruster.reversed else ""),
        )
        for thruster in known.thrusters
    ]


@click.group()
def vehicle() -> None:
    """Check a vehicle file, write a commented template, list what is shipped."""


@vehicle.command()
@click.argument("file")
@JSON
def check(file: str, as_json: bool) -> None:
    """What the vehicle of FILE (or a shipped name) can do; exit 1, with the reason, if it cannot be flown."""
    from autopilot.core.vehicle import load_vehicle
    from autopilot.core.vehicle_summary import CRUISE_M_S, facts_of

    known = load_vehicle(file)
    facts = facts_of(known)
    if as_json:
        emit_json({"name": known.name, "thrusters": [asdict(each) for each in _rows(known)], **asdict(facts)})
        return
    print_table(
        f"{known.name}: {known.description}",
        ("thruster", "channel", "position [m]", "pushes", "limit [N]", "drive"),
        [(row.name, row.channel, row.position, row.direction, f"{row.limit_n:g}", row.drive) for row in _rows(known)],
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
    from autopilot.core.errors import ConfigError

    if not name or any(mark in name for mark in '"\\/\n') or name.endswith(".toml"):
        raise ConfigError(f"{name!r} is no name for a vehicle; use letters, digits and dashes")
    target = Path(out or f"{name}.toml")
    text = (resources.files("autopilot") / "data" / "templates" / "vehicle.toml").read_text(encoding="utf-8")
    try:
        with target.open("x", encoding="utf-8") as file:
            file.write(text.replace('name = "NAME"', f'name = "{name}"', 1))
    except FileExistsError as error:
        raise ConfigError(f"{target} exists; choose another place with --out") from error
    except OSError as error:
        raise ConfigError(f"{target}: {error.strerror}; choose another place with --out") from error
    click.echo(f"{target}: edit it, then autopilot vehicle check {target}")
