"""Types of options: finite numbers (click's floats accept ``nan`` and ``inf``, also in open ranges), and names."""

import math
from typing import Any

import click

from autopilot.core.names import choice


class Finite(click.types.FloatParamType):
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number


class FiniteRange(click.FloatRange):
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        return float(super().convert(Finite().convert(value, param, ctx), param, ctx))


class OneOf(click.Choice[str]):
    """A name of several; about another one it says which was probably meant."""

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        return f"{value!r} is not known; {choice(str(value), self.choices)}"
