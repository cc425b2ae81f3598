"""``autopilot params``: the parameter table without a vehicle."""

from pathlib import Path

import click

from autopilot.cli.console_output import EXIT_LOSS, emit_json, print_table
from autopilot.cli.shared_options import JSON


@click.group()
def params() -> None:
    """List, explain and compare parameters."""


@params.command(name="list")
@JSON
def list_(as_json: bool) -> None:
    """All parameters with default, range, unit and meaning."""
    from autopilot.core.params import PARAMETERS

    rows = sorted(PARAMETERS, key=lambda spec: spec.name)
    if as_json:
        emit_json(
            [
                {
                    "name": spec.name,
                    "default": spec.default,
                    "minimum": spec.minimum,
                    "maximum": spec.maximum,
                    "unit": spec.unit,
                    "type": spec.type.value,
                    "help": spec.help,
                }
                for spec in rows
            ]
        )
        return
    print_table(
        "Parameters",
        ("name", "default", "minimum", "maximum", "unit", "meaning"),
        [(s.name, f"{s.default:g}", f"{s.minimum:g}", f"{s.maximum:g}", s.unit, s.help) for s in rows],
    )


@params.command()
@click.argument("file", type=click.Path(path_type=Path))
@JSON
def check(file: Path, as_json: bool) -> None:
    """Check a parameter file and show what differs from the defaults.

    Exit 3 if it has names that do not exist, or two values for one.
    """
    from autopilot.core.errors import ConfigError
    from autopilot.core.param_file import scan_param_file
    from autopilot.core.params import ParamSet

    found = scan_param_file(file)
    if found.errors:
        raise ConfigError(found.errors[0])
    values = found.values
    for unknown in found.unknown:
        click.echo(f"warning: {unknown}; the line is not used", err=True)
    for repeated in found.repeated:
        click.echo(f"warning: {repeated}; the later one is used, remove one of them", err=True)
    defaults = ParamSet()
    different = {name: value for name, value in values.items() if defaults[name] != value}
    if as_json:
        emit_json(
            {
                "read": len(values),
                "different": different,
                "unknown": list(found.unknown),
                "repeated": list(found.repeated),
            }
        )
    else:
        print_table(
            f"{file}: {len(values)} parameters, {len(different)} differ from the default",
            ("name", "value", "default"),
            [(name, f"{value:g}", f"{defaults[name]:g}") for name, value in sorted(different.items())],
        )
    if found.unknown or found.repeated:
        click.get_current_context().exit(EXIT_LOSS)


@params.command()
@click.argument("file", type=click.Path(path_type=Path))
def defaults(file: Path) -> None:
    """Write a parameter file with all defaults."""
    from autopilot.core.param_file import write_param_file
    from autopilot.core.params import ParamSet

    write_param_file(file, ParamSet())
    click.echo(f"{file}: {len(ParamSet())} parameters")
