"""Frozen dataclasses that are cheap to make, for what is made in every tick.

The ``__init__`` of a frozen dataclass sets each field by ``object.__setattr__``, which looks the name up in the whole
class; with slots the place of a field is known, and setting it there takes two thirds of the time. All else stays as
:func:`dataclasses.dataclass` makes it: signature, defaults, ``__post_init__``, ``replace``, and that nothing can be
assigned afterwards.
"""

from dataclasses import MISSING, Field, fields
from typing import Any, TypeVar

T = TypeVar("T")


def quick(cls: type[T]) -> type[T]:
    """Stands above ``@dataclass(frozen=True, slots=True, ...)``. TypeError for a class without slots."""
    own: tuple[Field[Any], ...] = fields(cls)  # type: ignore[arg-type]  # a dataclass, which its type does not say
    names: dict[str, Any] = {"_missing": MISSING}
    parameters = ["self"]
    keywords: list[str] = []
    lines: list[str] = []
    for field in own:
        name = field.name
        slot: Any = getattr(cls, name, None)
        if not hasattr(slot, "__set__") or not field.init:
            raise TypeError(f"{cls.__qualname__}.{name}: quick needs slots, and fields that are all given")
        names[f"_set_{name}"] = slot.__set__
        default = ""
        if field.default is not MISSING:
            names[f"_default_{name}"] = field.default
            default = f"=_default_{name}"
        elif field.default_factory is not MISSING:
            names[f"_make_{name}"] = field.default_factory
            default = "=_missing"
            lines.append(f"if {name} is _missing: {name} = _make_{name}()")
        (keywords if field.kw_only else parameters).append(name + default)
        lines.append(f"_set_{name}(self, {name})")
    if hasattr(cls, "__post_init__"):
        lines.append("self.__post_init__()")
    head = ", ".join([*parameters, *(["*", *keywords] if keywords else [])])
    exec(f"def __init__({head}):\n  " + "\n  ".join(lines or ["pass"]), names)
    made = names["__init__"]
    made.__annotations__ = {field.name: field.type for field in own} | {"return": None}
    made.__qualname__, made.__module__ = f"{cls.__qualname__}.__init__", cls.__module__
    setattr(cls, "__init__", made)  # noqa: B010 - assigning to it says that subclasses break
    return cls
