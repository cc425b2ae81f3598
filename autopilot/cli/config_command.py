"""``autopilot config``: settings of a run with their sources; a configuration to edit."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.console_output import emit_json, print_table
from autopilot.cli.shared_options import JSON

if TYPE_CHECKING:
    from autopilot.run.config import EffectiveSettings


@click.group()
def config() -> None:
    """Show the effective configuration, write a vehicle configuration to edit."""


@config.command()
@click.argument("scenario", required=False)
@click.option("--config", "file", metavar="FILE", help="What `autopilot run --config FILE` would use instead.")
@click.option("--instance", default=0, show_default=True, help="Instance number (sysid 1 + N).")
@JSON
def show(scenario: str | None, file: str | None, instance: int, as_json: bool) -> None:
    """Settings, scenario and vehicle of `autopilot sitl [SCENARIO]`, or of `autopilot run --config FILE`."""
    if scenario is not None and file is not None:
        raise click.UsageError(f"a scenario ({scenario}) or a vehicle's --config ({file}); give one")
    settings, trees = _of_sitl(scenario, instance) if file is None else _of_vehicle(file, instance)
    if as_json:
        origins = {name: {"value": s.value, "origin": s.origin} for name, s in settings.table.items()}
        emit_json({"settings": origins, **trees})
        return
    print_table(
        "Settings",
        ("name", "value", "origin"),
        [(name, setting.value, setting.origin) for name, setting in sorted(settings.table.items())],
    )
    for title, tree in trees.items():
        rows = [(key, value) for key, value in _flatten(tree) if not key.startswith("sources")]
        name = tree.get("name", "") if isinstance(tree, dict) else ""
        print_table(f"{title.capitalize()} {name}".rstrip(), ("key", "value"), rows)


@config.command()
@click.argument("name")
@click.option(
    "--from", "source", default="bluerov2-ardusub", show_default=True, help="Shipped configuration or file to copy."
)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), default=Path(), help="Folder (default: here).")
def new(name: str, source: str, out: Path) -> None:
    """Write NAME.toml, a commented configuration for `autopilot run` to edit, with its marker map beside it."""
    from autopilot.run.sitl_copy import write_copies
    from autopilot.run.vehicle_config import load_config

    loaded = load_config(source)
    target = out / f"{name}.toml"
    copies = {target: loaded.path.read_bytes()}
    if loaded.markers is not None and loaded.file.place.markers is not None:
        copies[out / loaded.file.place.markers] = loaded.markers.read_bytes()
    write_copies(copies, out)
    for path in copies:
        click.echo(str(path))
    click.echo(f"edit it, then: autopilot doctor --config {target}")


def _of_sitl(scenario: str | None, instance: int) -> "tuple[EffectiveSettings, dict[str, object]]":
    """Settings, and scenario and vehicle file with their defaults filled in."""
    import msgspec

    from autopilot.core.vehicle import load_vehicle
    from autopilot.run.config import gather, sitl_defaults
    from autopilot.sitl.scenario import load_scenario

    settings = gather(sitl_defaults(instance), {"scenario": scenario})
    loaded = load_scenario(settings["scenario"])
    vehicle = load_vehicle(loaded.vehicle.model)
    return settings, {"scenario": msgspec.to_builtins(loaded), "vehicle": msgspec.to_builtins(vehicle)}


def _of_vehicle(file: str, instance: int) -> "tuple[EffectiveSettings, dict[str, object]]":
    """Settings, and the configuration, its devices and vehicle file with their defaults filled in."""
    import msgspec

    from autopilot.run.config import gather, vehicle_defaults
    from autopilot.run.vehicle_config import load_config

    loaded = load_config(file)
    given = loaded.file.service.given(loaded.path.parent)
    settings = gather(vehicle_defaults(instance), {}, file=given, file_name=loaded.path.name)
    devices = {
        kind: {"driver": setup.driver, **msgspec.to_builtins(setup.options)} for kind, setup in loaded.devices.items()
    }
    return settings, {
        "place": msgspec.to_builtins(loaded.file.place),
        "devices": devices,
        "parameters": loaded.file.parameters,
        "vehicle": msgspec.to_builtins(loaded.vehicle),
    }


def _flatten(tree: object, prefix: str = "") -> list[tuple[str, object]]:
    """Leaves of nested tables with dotted keys."""
    if isinstance(tree, dict):
        return [leaf for key, value in tree.items() for leaf in _flatten(value, f"{prefix}.{key}" if prefix else key)]
    if isinstance(tree, list) and tree and isinstance(tree[0], dict):
        return [leaf for index, value in enumerate(tree) for leaf in _flatten(value, f"{prefix}[{index}]")]
    return [(prefix, tree)]
