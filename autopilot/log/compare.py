"""Comparison of two logs message by message, for tests of determinism and replays.

Times are compared on the service's clock, so that runs that started at different wall-clock times compare equal.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from autopilot.core.errors import LogError
from autopilot.log.reader import DecodedMessage, Log, MessageTable

WALL_CLOCK_TOPICS = ("/sys/loop", "/sys/process")
WALL_CLOCK_FIELDS = (
    *("/ctl/nmpc.solve_s", "/in/tick.cpu_load", "/in/tick.overruns", "/in/markers.decode_us"),
    *("/in/step.data.camera[1]", "/in/step.data.camera[2]"),  # size of the disk and what is free
)
"""Measurements of the machine, which differ between two runs of the same seed."""

_MESSAGES = " messages"
_STAMPS = ("stamp", "timestamp")
"""Fields of messages that hold the epoch."""

_SHOWN = 80
"""Characters of a value in a difference."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """First difference of a topic, or missing messages."""

    topic: str
    field: str
    """Empty if the topic differs as a whole."""
    t_s: float | None
    """Service's clock of the first difference."""
    what: str

    def __str__(self) -> str:
        place = self.topic + (f".{self.field}" if self.field else "")
        return f"{place}{'' if self.t_s is None else f' at {self.t_s:.3f} s'}: {self.what}"


def compare_logs(
    a: Log,
    b: Log,
    ignore_topics: Collection[str] = WALL_CLOCK_TOPICS,
    ignore_fields: Collection[str] = WALL_CLOCK_FIELDS,
    *,
    prefix: bool = False,
) -> list[Difference]:
    """Compare two logs message by message; metadata and attachments are not compared.

    Parameters
    ----------
    a, b
        The logs.
    ignore_topics
        Topics that are not compared.
    ignore_fields
        ``topic.field``, or a field's name for all topics.
    prefix
        One may end early: only the common part is compared.

    Returns
    -------
    list of Difference
        At most one per field; empty = identical messages.
    """
    found: list[Difference] = []
    for topic in sorted({*a.topics, *b.topics} - set(ignore_topics)):
        missing = next((log for log in (a, b) if topic not in log.topics), None)
        if missing is not None and prefix:
            continue
        if missing is not None:
            found.append(Difference(topic=topic, field="", t_s=None, what=f"is missing in {missing.path.name}"))
            continue
        try:
            found += _compare_tables(topic, a[topic], b[topic], ignore_fields)
        except LogError:
            found += _compare_messages(topic, a, b, ignore_fields)
    return [one for one in found if not (prefix and one.what.endswith(_MESSAGES))]


def _ignored(topic: str, field: str, ignore_fields: Collection[str]) -> bool:
    return field in ignore_fields or f"{topic}.{field}" in ignore_fields


def _count(topic: str, first: int, second: int) -> list[Difference]:
    if first == second:
        return []
    return [Difference(topic=topic, field="", t_s=None, what=f"{first} against {second}{_MESSAGES}")]


def _compare_tables(topic: str, a: MessageTable, b: MessageTable, ignore_fields: Collection[str]) -> list[Difference]:
    found = _count(topic, len(a), len(b))
    rows = min(len(a), len(b))
    if a.dtype != b.dtype:
        return [*found, Difference(topic=topic, field="", t_s=None, what="the types differ")]
    for field in a.dtype.names or ():
        if _ignored(topic, field, ignore_fields) or not rows:
            continue
        left, right = _bytes(a[field][:rows]), _bytes(b[field][:rows])
        differs = np.flatnonzero((left != right).any(axis=1))
        if len(differs):
            at = int(differs[0])
            what = f"{_show(a[field][at])} against {_show(b[field][at])} ({len(differs)} of {rows} messages differ)"
            found.append(Difference(topic=topic, field=field, t_s=float(a["t_us"][at]) * 1e-6, what=what))
    return found


def _bytes(values: Any) -> Any:
    """(n, size) bytes of a column: equality bit by bit, so that NaN equals NaN and 0 differs from -0."""
    packed = np.ascontiguousarray(values)
    return packed.view(np.uint8).reshape(len(packed), -1)


def _show(value: Any) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _compare_messages(topic: str, a: Log, b: Log, ignore_fields: Collection[str]) -> list[Difference]:
    left, right = a.messages(topic), b.messages(topic)
    found = _count(topic, len(left), len(right))
    for first, second in zip(left, right, strict=False):
        if first.t_us != second.t_us:
            what = f"{first.t_us} us against {second.t_us} us"
            found.append(Difference(topic=topic, field="t_us", t_s=first.t_us * 1e-6, what=what))
            break
        place = _first_difference(_opened(topic, first), _opened(topic, second), topic, "", ignore_fields)
        if place is not None:
            found.append(Difference(topic=topic, field=place[0], t_s=first.t_us * 1e-6, what=place[1]))
            break
    return found


def _opened(topic: str, message: DecodedMessage) -> dict[str, Any]:
    """A message's fields, with JSON texts parsed."""
    return (
        message.value if topic != "/in/step" else {**message.value, "data": msgspec.json.decode(message.value["data"])}
    )


def _first_difference(a: Any, b: Any, topic: str, field: str, ignore_fields: Collection[str]) -> tuple[str, str] | None:
    """Path and description of the first difference of two decoded messages; stamps hold the epoch and are left out."""
    if isinstance(a, dict) and isinstance(b, dict):
        keys = [*a, *(key for key in b if key not in a)]
        pairs = [(f"{field}.{key}".lstrip("."), a.get(key), b.get(key)) for key in keys if key not in _STAMPS]
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        pairs = [(f"{field}[{index}]", *pair) for index, pair in enumerate(zip(a, b, strict=True))]
    else:
        same = a == b or (isinstance(a, float) and isinstance(b, float) and a != a and b != b)
        return None if same else (field, f"{_show(a)} against {_show(b)}")
    for name, first, second in pairs:
        if not _ignored(topic, name, ignore_fields):
            place = _first_difference(first, second, topic, name, ignore_fields)
            if place is not None:
                return place
    return None
