"""Reading of TOML files into typed tables."""

import math
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec

from autopilot.core.errors import ConfigError

MOST = 1e30
"""Of any number: products of a few of them are still finite."""
SHOWN = 30
"""Characters of a number in messages."""
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Delay = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
"""Seconds within the estimator's history; milliseconds are beyond."""
Rate = Annotated[float, msgspec.Meta(ge=0.1, le=10_000.0)]
Sigma = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
"""Standard deviation in metres, radians, seconds, or as a share; millimetres, degrees and percent are beyond."""
_Arm = Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]
Angle = Annotated[float, msgspec.Meta(ge=-6.3, le=6.3)]
"""Radians, one turn at most; degrees are beyond."""
Vec2: TypeAlias = tuple[float, float]
Vec3: TypeAlias = tuple[float, float, float]
Place3: TypeAlias = tuple[_Arm, _Arm, _Arm]
"""Metres on a small vehicle; millimetres are beyond."""
Angles3: TypeAlias = tuple[Angle, Angle, Angle]
Sigma3: TypeAlias = tuple[Sigma, Sigma, Sigma]
Positive3: TypeAlias = tuple[Positive, Positive, Positive]
Positive4: TypeAlias = tuple[Positive, Positive, Positive, Positive]
NonNegative3: TypeAlias = tuple[NonNegative, NonNegative, NonNegative]
NonNegative4: TypeAlias = tuple[NonNegative, NonNegative, NonNegative, NonNegative]


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A TOML table: immutable, unknown keys are errors."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; ConfigError names the file and the line when it is not one."""
    try:
        return parse_toml(path.read_text(encoding="utf-8-sig"), str(path))  # editors on Windows begin with a mark
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text; save it as UTF-8") from error


def parse_toml(text: str, origin: str) -> dict[str, Any]:
    """The tables of a TOML text; ConfigError begins with ``origin`` and names the line when it is not one."""
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also of whole numbers of thousands of digits
        raise ConfigError(f"{origin}: is not valid TOML: {error}; correct it there") from error
    except RecursionError as error:
        raise ConfigError(f"{origin}: is not valid TOML: it is nested too deeply; correct it") from error


def convert(tables: dict[str, Any], kind: type, origin: str, rules: Callable[[Any], list[str]] = lambda _: []) -> Any:
    """``tables`` as ``kind``.

    Parameters
    ----------
    rules
        Mistakes of a whole ``kind`` beyond its types: also asked, where there are other mistakes, of what is left
        without these.

    Raises
    ------
    ConfigError
        Names the path of the key, the problem, the allowed values, and the file; of several mistakes each on a line
        of its own.
    """
    found = [
        f"`{place}` = {str(value)[:SHOWN]} is {'too large' if abs(value) < math.inf else 'not a finite number'};"
        " correct or remove that key"
        for place, value in _leaves(tables, "$")
        if isinstance(value, int | float) and not abs(value) <= MOST
    ]
    if not found:
        try:
            whole: Any = msgspec.convert(tables, kind, strict=True)
            found = rules(whole)
            if not found:
                return whole
        except msgspec.ValidationError:
            from autopilot.core.toml_names import mistakes  # for errors only

            found, left = mistakes(tables, kind)
            found += rules(left) if left is not None else []
    raise mistaken(origin, found)


def mistaken(origin: str, found: Sequence[str]) -> ConfigError:
    """The error about these mistakes, at least one, in the file ``origin``."""
    if len(found) == 1:
        return ConfigError(f"{origin}: {found[0]}")
    return ConfigError(f"{origin}: {len(found)} mistakes:\n" + "\n".join(f"  {text}" for text in found))


def _leaves(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Every value of nested tables and arrays with the path of its key."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{place}.{key}")
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _leaves(inner, f"{place}[{index}]")
    else:
        yield place, value
