"""``autopilot config``: settings of a run with their sources; a configuration to edit."""

import contextlib
import copy
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.completion import CONFIG_NAME, SCENARIO_NAME
from autopilot.cli.console_output import emit_json, print_table
from autopilot.cli.shared_options import COPY_OUT, INSTANCE, JSON

if TYPE_CHECKING:
    from autopilot.run.config import EffectiveSettings

USUAL_CONFIG = "bluerov2-ardusub"
"""What `config new` copies."""


@click.group()
def config() -> None:
    """Show the effective configuration, write a vehicle configuration to edit."""


@config.command()
@click.argument("scenario", type=SCENARIO_NAME, required=False)
@click.option(
    "--config", "file", type=CONFIG_NAME, metavar="FILE", help="What `autopilot run --config FILE` would use instead."
)
@INSTANCE
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
    "--from",
    "source",
    type=CONFIG_NAME,
    help=f"Shipped configuration or file to copy; default: the shipped one of that NAME, or {USUAL_CONFIG}.",
)
@COPY_OUT
def new(name: str, source: str | None, out: Path | None) -> None:
    """Write NAME.toml, a commented configuration for `autopilot run` to edit, with its marker map beside it."""
    from autopilot.run.sitl_copy import check_file_name, copy_target, write_copies
    from autopilot.run.vehicle_config import config_names, load_config

    check_file_name(name)
    loaded = load_config(source or (name if name in config_names() else USUAL_CONFIG))
    target = copy_target(name, out)
    copies = {target: loaded.path.read_bytes()}
    if loaded.markers is not None and loaded.file.place.markers is not None:
        copies[target.parent / loaded.file.place.markers] = loaded.markers.read_bytes()
    write_copies(copies, target.parent)
    for path in copies:
        click.echo(str(path))
    click.echo(f"edit it, then: autopilot doctor --config {target}")


WRITE = copy.copy(new)
"""`config write` is what `config new` does; the help lists one of them."""
WRITE.hidden = True
config.add_command(WRITE, "write")


@config.command()
@click.option("--config", "file", type=CONFIG_NAME, metavar="FILE", help="Of `autopilot run --config FILE` instead.")
@JSON
def paths(file: str | None, as_json: bool) -> None:
    """Where state and logs of `autopilot sitl` lie, how large they are, and how to remove them."""
    from autopilot.run.config import gather, sitl_defaults

    settings = gather(sitl_defaults(0), {}) if file is None else _of_vehicle(file, 0)[0]
    rows = []
    for name, holds in (("state_dir", "parameters, plans, signing keys, by instance"), ("log_dir", "logs, stills")):
        folder = Path(settings[name]).expanduser().absolute()
        rows.append((name, holds, str(folder), _size_mb(folder), settings.table[name].origin))
    if as_json:
        emit_json([dict(zip(("name", "holds", "folder", "size_mb", "origin"), row, strict=True)) for row in rows])
        return
    for name, holds, folder_text, size_mb, origin in rows:
        click.echo(f"{name} ({origin}): {holds}, {size_mb:.1f} MB")
        click.echo(f"    {folder_text}")
        click.echo(
            f"    remove: rm -r {shlex.quote(folder_text)}" if Path(folder_text).exists() else "    not there yet"
        )


def _size_mb(folder: Path) -> float:
    """Of all files in there; some may go meanwhile."""
    size = 0
    for each in folder.rglob("*"):
        with contextlib.suppress(OSError):
            size += each.lstat().st_size
    return 1e-6 * size


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
