"""Numbers given on the command line: ``nan`` and ``inf`` are floats as well, and pass comparisons or an open end."""

import math
from typing import Any

import click


class Finite(click.types.FloatParamType):
    """Any number."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """See :class:`click.ParamType`."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number


class FiniteRange(click.FloatRange):
    """A number within its bounds."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """See :class:`click.ParamType`."""
        return float(super().convert(Finite().convert(value, param, ctx), param, ctx))
