"""What an object holds: the size of every table that can be reached from it."""

import gc
import types
from collections import deque
from typing import Any

import numpy as np

_LEAVES = (
    type,
    types.ModuleType,
    types.CodeType,
    types.BuiltinFunctionType,
    int,
    float,
    str,
    bytes,
    complex,
    np.ndarray,
)
_TABLES = (dict, list, set, frozenset, deque, bytearray)


def tables(root: object, without: tuple[object, ...] = ()) -> dict[str, int]:
    """Path -> length of every container that may grow, of those of one path the longest; nothing beyond ``without``."""
    seen = {id(root), *map(id, without)}
    found: dict[str, int] = {}
    keep: list[object] = []
    waiting: deque[tuple[str, Any]] = deque([("", root)])
    while waiting:
        path, thing = waiting.popleft()
        keep.append(thing)  # so that no number is given to another meanwhile
        if isinstance(thing, _TABLES):
            found[path] = max(found.get(path, 0), len(thing))
        for name, part in _parts(thing):
            if part is not None and not isinstance(part, _LEAVES) and id(part) not in seen:
                seen.add(id(part))
                waiting.append((path + name, part))
    return found


def _parts(thing: Any) -> list[tuple[str, Any]]:
    """What a thing refers to, each with its name."""
    if isinstance(thing, dict):
        parts = [(f"[{key}]" if isinstance(key, str) else "[]", value) for key, value in thing.items()]
        parts += [("<key>", key) for key in thing]
    elif isinstance(thing, list | tuple | set | frozenset | deque):
        parts = [("[]", value) for value in thing]
    elif isinstance(thing, types.MethodType):
        return [(".self", thing.__self__)]
    elif isinstance(thing, types.FunctionType):
        return [("()", value) for value in gc.get_referents(*(thing.__closure__ or ()))]
    else:
        parts = []
    named = dict(getattr(thing, "__dict__", {}))
    for kind in type(thing).__mro__:
        slots = kind.__dict__.get("__slots__", ())
        named |= {name: getattr(thing, name, None) for name in ((slots,) if isinstance(slots, str) else slots)}
    parts += [(f".{name}", value) for name, value in named.items()]
    return parts or [("~", value) for value in gc.get_referents(thing)]
