"""Options that name a controller, an estimator or a plant: a shipped one, a package's, or package:Class."""

import click

from autopilot.run.config import SHIPPED_PARTS, is_part


def part_name(_: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Callback of such an option: the name, if there may be such a part."""
    kind = str(param.name)
    if value is not None and not is_part(kind, value):
        names = ", ".join(map(repr, SHIPPED_PARTS[kind]))
        raise click.BadParameter(f"{value!r} is not one of {names}; for your own write package:Class")
    return value
