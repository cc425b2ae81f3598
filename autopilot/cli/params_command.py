"""``autopilot params`` and ``failsafes``: the tables of parameters and failsafes without a vehicle."""

import re
from dataclasses import asdict
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
        same = ("name", "default", "minimum", "maximum", "unit", "help")
        emit_json([{"type": spec.type.value, **{name: getattr(spec, name) for name in same}} for spec in rows])
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


@click.command()
@JSON
@click.option("--markdown", is_flag=True, help="As a Markdown table.")
@click.option("--write", type=click.Path(path_type=Path, dir_okay=False, exists=True), help="Bring a page up to date.")
def failsafes(as_json: bool, markdown: bool, write: Path | None) -> None:
    """All failsafes: when they begin and end, what they do (with the default), what they say."""
    from autopilot.command.failsafe_docs import failsafe_markdown, failsafe_texts, with_table

    if write is not None:
        write.write_text(with_table(write.read_text(encoding="utf-8")), encoding="utf-8")
    elif as_json:
        emit_json([asdict(text) for text in failsafe_texts()])
    elif markdown:
        click.echo(failsafe_markdown(), nl=False)
    else:
        columns = ("bit", "failsafe", "begins when", "ends", "action", "message")
        rows = [tuple(asdict(text).values()) for text in failsafe_texts()]
        print_table("Failsafes", columns, [[_plain(str(cell)) for cell in row] for row in rows])


def _plain(cell: str) -> str:
    """Without the marks of Markdown."""
    return re.sub(r"\*\*(.+?)\*\*", r"\1 (default)", cell.replace("`", ""))
