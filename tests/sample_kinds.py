"""A sample of any kind out of what somebody draws: the one walk over the table of samples."""

from collections.abc import Mapping
from enum import Enum
from types import NoneType
from typing import Any, Protocol, get_args, get_type_hints

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.log.sample_table import SampleRow
from autopilot.log.schemas import layout


class Draw(Protocol):
    """Where values come from. ``name`` is the attribute that a value is for."""

    def missing(self) -> bool:
        """Whether a value that may be None is."""

    def scalar(self, name: str, kind: type) -> Any:
        """A bool, int or float."""

    def member(self, kind: type[Enum]) -> Enum:
        """One of an enumeration."""

    def array(self, name: str, size: int) -> FloatArray:
        """(size,)."""


def sample_of(row: SampleRow, t_us: int, draw: Draw) -> Any:
    """A sample of a kind, its attributes drawn in their order. Not for MarkerSighting, whose arrays belong together."""
    fields: Mapping[str, Any] = layout(f"autopilot_msgs/{row.type}").dtype.fields or {}
    values: dict[str, Any] = {"t_us": t_us}
    for name, hint in get_type_hints(row.of).items():
        if name in values:
            continue
        kinds = [kind for kind in get_args(hint) if kind is not NoneType] if NoneType in get_args(hint) else [hint]
        (kind,) = kinds
        if kinds != [hint] and draw.missing():
            values[name] = None
        elif kind in (bool, int, float):
            values[name] = draw.scalar(name, kind)
        elif isinstance(kind, type) and issubclass(kind, Enum):
            values[name] = draw.member(kind)
        else:
            size = int(np.prod(fields[name][0].shape))
            values[name] = draw.array(name, size).reshape(row.shapes.get(name, (size,)))
    return row.of(**values)
