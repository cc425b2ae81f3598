"""Types of arguments that the shell completes by name: scenarios, vehicles, configurations, parameters, parts."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

if TYPE_CHECKING:
    _TextType = click.ParamType[str]
else:
    _TextType = click.ParamType  # older ones know no type arguments


class Named(_TextType):
    """Any text; the names are offered, and files unless that is told otherwise."""

    name = "text"

    def __init__(self, names: Callable[[], Sequence[str]], *, files: bool = True) -> None:
        """``names`` is called when the shell asks."""
        self._names, self._files = names, files

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        found = [CompletionItem(name) for name in self._names() if name.startswith(incomplete)]
        return found or ([CompletionItem(incomplete, type="file")] if self._files else [])


def _scenarios() -> Sequence[str]:
    from autopilot.sitl.scenario import scenario_names

    return scenario_names()


def _vehicles() -> Sequence[str]:
    from autopilot.core.vehicle import vehicle_names

    return vehicle_names()


def _configs() -> Sequence[str]:
    from autopilot.run.vehicle_config import config_names

    return config_names()


def _params() -> Sequence[str]:
    from autopilot.core.params import ParamSet

    return [f"{name}=" for name in ParamSet()]


SCENARIO_NAME = Named(_scenarios)
VEHICLE_NAME = Named(_vehicles)
CONFIG_NAME = Named(_configs)
PARAM_VALUE = Named(_params, files=False)
