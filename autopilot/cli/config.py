"""``autopilot config``: what a run would use, and where each value comes from."""

import click

from autopilot.cli.output import emit_json, print_table


@click.group()
def config() -> None:
    """Show the effective configuration."""


@config.command()
@click.argument("scenario", required=False)
@click.option("--instance", default=0, show_default=True, help="Instance number (sysid 1 + N).")
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
def show(scenario: str | None, instance: int, as_json: bool) -> None:
    """Settings, scenario and vehicle of `autopilot sitl [SCENARIO]`."""
    import msgspec

    from autopilot.core.vehicle import load_vehicle
    from autopilot.run.config import gather, sitl_defaults
    from sitl.scenario import load_scenario

    settings = gather(sitl_defaults(instance), {"scenario": scenario})
    loaded = load_scenario(settings["scenario"])
    vehicle = load_vehicle(loaded.vehicle.model)
    if as_json:
        emit_json(
            {
                "settings": {name: {"value": s.value, "origin": s.origin} for name, s in settings.table.items()},
                "scenario": msgspec.to_builtins(loaded),
                "vehicle": msgspec.to_builtins(vehicle),
            }
        )
        return
    print_table(
        "Settings",
        ("name", "value", "origin"),
        [(name, setting.value, setting.origin) for name, setting in sorted(settings.table.items())],
    )
    for title, tree in (("Scenario", msgspec.to_builtins(loaded)), ("Vehicle", msgspec.to_builtins(vehicle))):
        rows = [(key, value) for key, value in _flatten(tree) if not key.startswith("sources")]
        print_table(f"{title} {tree.get('name', settings['scenario'])}", ("key", "value"), rows)


def _flatten(tree: object, prefix: str = "") -> list[tuple[str, object]]:
    """Leaves of nested tables with dotted keys."""
    if isinstance(tree, dict):
        return [leaf for key, value in tree.items() for leaf in _flatten(value, f"{prefix}.{key}" if prefix else key)]
    if isinstance(tree, list) and tree and isinstance(tree[0], dict):
        return [leaf for index, value in enumerate(tree) for leaf in _flatten(value, f"{prefix}[{index}]")]
    return [(prefix, tree)]
