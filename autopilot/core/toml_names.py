"""Checks of names in TOML files: unknown keys, kinds and values, with the allowed ones in the message."""

import copy
import re
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
from msgspec import inspect

from autopilot.core.names import choice, nearest

_STEP = re.compile(r"\.(?P<key>[^.\[\]]+)|\[(?P<index>\d+|\.\.\.)\]")
_PLACE = r"(?: - at `(?P<place>\$[^`]*)`)?"
_NO_KEY = re.compile(rf"unknown field `(?P<name>[^`]*)`{_PLACE}")
_NO_VALUE = re.compile(rf"Invalid (?:enum )?value '(?P<name>[^']*)'{_PLACE}")
_NO_KIND = re.compile(rf"missing required field `(?P<name>kind)`{_PLACE}")
_MISSING = re.compile(r"missing required field `(?P<name>[^`]*)`")
_ENTRY = re.compile(r" - at `(?P<place>\$[^`]*?)\[\.\.\.\]")
_LAST_INDEX = re.compile(r"(?P<array>\$.*)\[(?P<index>\d+)\]")
_BY_TYPE = re.compile(r"Object |Expected |Invalid ")
"""Errors of msgspec itself; others are those of a table's own rules."""
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ANYWHERE = re.compile(r" - at `(?P<place>\$[^`]*)`")
MOST_MISTAKES = 20
MOST_LETTERS = 40
"""Of a wrong value that is shown."""


def mistakes(tables: dict[str, Any], kind: type) -> tuple[list[str], Any]:
    """Every mistake of the tables as a ``kind`` with its remedy, MOST_MISTAKES at most, and the ``kind`` without them.

    msgspec names the first mistake, and is asked again without the key that it names; None, if what is left is no
    ``kind``.
    """
    left, removed = copy.deepcopy(tables), set[tuple[str, str]]()
    taken: dict[str, list[int]] = {}
    """Indices of the entries that were taken out of an array."""
    found: list[str] = []
    while len(found) < MOST_MISTAKES:
        refused = _refused(left, kind)
        error = with_entry(refused, left, kind)
        missing, where = _MISSING.search(error), _ANYWHERE.search(error)
        place = "$" if where is None else where["place"]
        if not error:
            return found, msgspec.convert(left, kind, strict=True)
        # A key that was taken out, or that another was probably meant to be, is not missing; a table without it may
        # break rules of the table.
        if missing is not None:
            follows = (place, missing["name"]) in removed
        else:
            follows = not _BY_TYPE.match(error) and any(table.startswith(place) for table, _ in removed)
        if not follows:
            found.append(_renumbered(f"{error}; {remedy(refused, left, kind)}", taken))
        unknown, entry = _NO_KEY.search(error), _LAST_INDEX.fullmatch(place)
        if missing is not None and entry is not None:
            rows = _value_at(left, entry["array"])
            del rows[int(entry["index"])]
            taken.setdefault(entry["array"], []).append(int(entry["index"]))
            continue
        table, key = (place, unknown["name"]) if unknown else _holder(place)
        value = _at(left, table).pop(key, None) if key else None
        if value is None:
            break
        removed.add((table, key))
        if unknown:
            types = _types_at(inspect.type_info(kind), left, table)
            names = [field.encode_name for each in types for field in _fields(each)]
            meant = nearest(key, names)
            if meant and (table, meant) not in removed:
                _at(left, table).setdefault(meant, value)
    return found, None


def _renumbered(text: str, taken: dict[str, list[int]]) -> str:
    """The text with indices of arrays as they were before entries were taken out."""

    def number(found: re.Match[str]) -> str:
        index = int(found["index"])
        for gone in reversed(taken[found["array"]]):
            index += gone <= index
        return f"{found['array']}[{index}]"

    for array in taken:
        text = re.sub(rf"(?P<array>{re.escape(array)})\[(?P<index>\d+)\]", number, text)
    return text


def _fields(here: inspect.Type) -> tuple[inspect.Field, ...]:
    return here.fields if isinstance(here, inspect.StructType) else ()


def _holder(place: str) -> tuple[str, str]:
    """Path of the table that holds the value at a path, directly or in arrays, and its key there; no key for the whole.

    ``$.obstacle[0].center_m[1]`` is held by ``$.obstacle[0]`` as ``center_m``.
    """
    steps = list(_STEP.finditer(place))
    last = next((step for step in reversed(steps) if step["key"] is not None), None)
    return ("$", "") if last is None else (place[: last.start()], last["key"])


def remedy(error: str, tables: dict[str, Any], kind: type) -> str:
    """Allowed values in place of the one that msgspec refused with ``error`` when it read ``tables`` as ``kind``."""
    whole = inspect.type_info(kind)
    found = _NO_KEY.search(error)
    if found is not None:
        here = list(_types_at(whole, tables, found["place"] or "$"))
        tables_here = [each for each in here if isinstance(each, inspect.StructType)]
        names = [each.tag_field for each in tables_here if each.tag_field]
        names += [field.encode_name for each in tables_here for field in each.fields]
        return choice(found["name"], names)
    found = _NO_VALUE.search(error)
    if found is not None and found["place"]:
        here = list(_types_at(whole, tables, found["place"]))
        texts = [str(value) for each in here if isinstance(each, inspect.LiteralType) for value in each.values]
        return choice(found["name"], texts or _kinds(whole, tables, found["place"].rpartition(".")[0]))
    found = _NO_KIND.search(error)
    if found is not None:
        return choice("", _kinds(whole, tables, found["place"] or "$"))
    found = _MISSING.search(error)
    if found is not None:
        return f"add {found['name']}"
    found = _ANYWHERE.search(error)
    value_text = "" if found is None else _value_text(tables, found["place"])
    return f"{value_text}{choice('', ())}"


def with_entry(error: str, tables: dict[str, Any], kind: type) -> str:
    """An error with the name of the entry that msgspec leaves open as ``[...]``: the one that is refused alone, too."""
    found = _ENTRY.search(error)
    if found is None:
        return error
    place = found["place"]
    name = next((key for key in _at(tables, place) if _refused(_only(tables, place, key), kind) == error), None)
    if name is None:
        return error
    step = f".{name}" if _BARE.fullmatch(name) else f'."{name}"'
    return error.replace(f"{place}[...]", f"{place}{step}", 1)


def _at(tables: dict[str, Any], place: str) -> dict[str, Any]:
    """The table at a path; an empty one where there is none."""
    value = _value_at(tables, place)
    return value if isinstance(value, dict) else {}


def _value_at(tables: dict[str, Any], place: str) -> Any:
    """The value at a path, None where there is none."""
    value: Any = tables
    for step in _STEP.finditer(place):
        try:
            value = value[step["key"] if step["index"] is None else int(step["index"])]
        except (IndexError, KeyError, TypeError, ValueError):
            return None
    return value


def _only(tables: dict[str, Any], place: str, key: str) -> dict[str, Any]:
    """The tables with nothing but one entry in the table at a path."""
    copied = copy.deepcopy(tables)
    table = _at(copied, place)
    for other in [name for name in table if name != key]:
        del table[other]
    return copied


def _refused(tables: dict[str, Any], kind: type) -> str:
    """Validation error of the tables, "" if they are valid."""
    try:
        msgspec.convert(tables, kind, strict=True)
    except msgspec.ValidationError as error:
        return str(error)
    return ""


def _value_text(tables: dict[str, Any], place: str) -> str:
    """The value at a path as text before a remedy; "" if the path does not identify the entry."""
    value: Any = tables
    for step in _STEP.finditer(place):
        key = step["key"] if step["index"] is None else int(step["index"]) if step["index"].isdecimal() else None
        try:
            value = value[key]
        except (IndexError, KeyError, TypeError):
            return ""
    shown = repr(value)
    return f"it is {shown if len(shown) <= MOST_LETTERS else shown[: MOST_LETTERS - 3] + '...'}: "


def _kinds(whole: inspect.Type, tables: dict[str, Any], place: str) -> list[str]:
    """Possible kinds of the table at ``place``, whatever its ``kind`` key."""
    here = list(_types_at(whole, tables, place, any_kind=True))
    return [str(each.tag) for each in here if isinstance(each, inspect.StructType) and each.tag is not None]


def _types_at(
    whole: inspect.Type, tables: dict[str, Any], place: str, *, any_kind: bool = False
) -> Iterator[inspect.Type]:
    """Allowed types at a path such as ``$.obstacle[0].center_m``."""
    steps = [step["key"] or step["index"] for step in _STEP.finditer(place)]
    yield from _below(whole, tables, steps, any_kind)


def _below(here: inspect.Type, value: Any, steps: Sequence[str], any_kind: bool) -> Iterator[inspect.Type]:
    match here:
        case inspect.UnionType(types=types):
            for each in types:
                if (any_kind and not steps) or not _another_kind(each, value):
                    yield from _below(each, value, steps, any_kind)
        case _ if not steps:
            yield here
        case inspect.StructType(fields=fields):
            inner = value.get(steps[0]) if isinstance(value, dict) else None
            for field in fields:
                if field.encode_name == steps[0]:
                    yield from _below(field.type, inner, steps[1:], any_kind)
        case inspect.DictType(value_type=entry):
            inner = value.get(steps[0]) if isinstance(value, dict) else None
            yield from _below(entry, inner, steps[1:], any_kind)
        case inspect.ListType(item_type=entry) if steps[0].isdecimal():
            known = isinstance(value, list) and int(steps[0]) < len(value)
            yield from _below(entry, value[int(steps[0])] if known else None, steps[1:], any_kind)


def _another_kind(one: inspect.Type, value: Any) -> bool:
    """Whether the table ``value`` declares another kind than ``one``."""
    tagged = isinstance(one, inspect.StructType) and one.tag_field is not None and isinstance(value, dict)
    return tagged and isinstance(one, inspect.StructType) and one.tag_field in value and value[one.tag_field] != one.tag
