"""Names of classes that a program hands over, by which the settings of a run ask for parts."""

import sys
from collections.abc import Callable
from itertools import chain, count
from operator import attrgetter
from typing import Any

Part = str | Callable[..., Any]
"""A name (docs/extend.md), or the class itself (any callable that takes the context and makes one)."""


class Local:
    """Attributes are the parts that no module has under their own name (those of a function, a lambda)."""


def part_name(part: Part | None) -> str | None:
    """The name under which :func:`autopilot.core.plugins.find_plugin` finds that part."""
    if part is None or isinstance(part, str):
        return part
    module, path = getattr(part, "__module__", "") or "", getattr(part, "__qualname__", "")
    try:
        if attrgetter(path)(sys.modules[module]) is part:
            return f"{module}:{path}"
    except (KeyError, AttributeError):
        pass
    stem = path.rpartition(".")[2]
    stem = stem if stem.isidentifier() else type(part).__name__
    names = chain((stem,), (f"{stem}_{number}" for number in count(2)))
    name = next(name for name in names if getattr(Local, name, part) is part)
    setattr(Local, name, part)
    return f"{Local.__module__}:{Local.__qualname__}.{name}"
