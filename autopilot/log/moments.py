"""A log at any moment: the last message of each topic up to a time, without reading the whole file.

Where the messages of each topic lie is taken from the message index behind every chunk; chunks are unpacked when a
moment needs them, and the last ones are kept.
"""

import struct
import threading
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from autopilot.core.errors import LogError
from autopilot.log.cdr import decode, fixed_layout
from autopilot.log.container import MESSAGE_HEAD_BYTES, PREFIX_BYTES, ChunkRef, Damage, find_messages, unpack
from autopilot.log.reader import Log

KEPT_CHUNKS = 64
"""Unpacked chunks in memory, a quarter of a megabyte each."""
_MESSAGE_INDEX = 0x07
_INDEX_HEAD = struct.Struct("<BQHI")
_ENTRY = struct.Struct("<QQ")


class Fields(dict[str, Any]):
    """Values of a message by name; a field that an older log does not have is 0."""

    def __missing__(self, name: str) -> Any:
        return np.float64(0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Unpacked:
    """A chunk with the times and places of its messages by topic, in the order of time."""

    data: bytes
    times_ns: Mapping[str, NDArray[np.uint64]]
    spans: Mapping[str, NDArray[np.int64]]
    """(n, 2) begin and end of each message's data."""


class LogMoments:
    """Random access by time. Safe for several threads."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, _Unpacked] = OrderedDict()
        self._layouts: dict[str, np.dtype[np.void] | None] = {}
        self._chunks = list(log.contents.chunks)
        self._topics = {number: channel.topic for number, channel in log.contents.channels.items()}
        self._first_ns: dict[str, list[int]] = {}
        """Time of the first message in each chunk with the topic, never falling,"""
        self._numbers: dict[str, list[int]] = {}
        """and which chunk that is."""
        self._last_ns = 0
        self._index()

    @property
    def span_us(self) -> tuple[int, int]:
        """First and last time of ticks on the service's clock; of all messages in a log without them."""
        ticks = next((topic for topic in ("/in/tick", "/nav/state", "/sys/mode") if topic in self._numbers), None)
        topics = self._numbers if ticks is None else (ticks,)
        begins = [self._first_ns[topic][0] for topic in topics]
        if not begins:
            return 0, 0
        ends = [found[0] for topic in topics if (found := self.latest_raw(topic, self._last_us())) is not None]
        return self._us(min(begins)), max([self._us(min(begins)), *ends])

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics with messages."""
        return tuple(self._numbers)

    def latest(self, topic: str, t_us: int) -> Fields | None:
        """The last message of a fixed-size topic up to a time, with its time as ``t_us``; None if there is none."""
        found = self.latest_raw(topic, t_us)
        return None if found is None else self._fields(topic, *found)

    def latest_value(self, topic: str, t_us: int) -> dict[str, Any] | None:
        """The same for topics of any type."""
        found = self.latest_raw(topic, t_us)
        return None if found is None else self._value(topic, *found)

    def latest_raw(self, topic: str, t_us: int) -> tuple[int, bytes] | None:
        """Its time [us] and CDR bytes."""
        t_ns = self._log.epoch_ns + 1000 * t_us + 999
        with self._lock:
            at = bisect_right(self._first_ns.get(topic, ()), t_ns)
            for number in reversed(self._numbers.get(topic, [])[:at]):
                chunk = self._unpacked(number)
                times = chunk.times_ns.get(topic)
                row = 0 if times is None else int(np.searchsorted(times, t_ns, side="right"))
                if times is not None and row:
                    begin, end = chunk.spans[topic][row - 1].tolist()
                    return self._us(int(times[row - 1])), chunk.data[begin:end]
        return None

    def every(self, topic: str) -> Iterator[tuple[int, dict[str, Any]]]:
        """Time [us] and value of each message of a topic of any type; damaged ones are left out."""
        for number in self._numbers.get(topic, ()):
            with self._lock:
                chunk = self._unpacked(number)
            spans = chunk.spans[topic].tolist() if topic in chunk.spans else ()
            for time_ns, (begin, end) in zip(chunk.times_ns.get(topic, ()), spans, strict=True):
                value = self._value(topic, self._us(int(time_ns)), chunk.data[begin:end])
                if value is not None:
                    yield value["t_us"], value

    def _us(self, time_ns: int) -> int:
        return (time_ns - self._log.epoch_ns) // 1000

    def _last_us(self) -> int:
        return self._us(self._last_ns)

    def _fields(self, topic: str, t_us: int, data: bytes) -> Fields | None:
        """None for a message that does not fit its schema."""
        if topic not in self._layouts:
            self._layouts[topic] = self._layout(topic, data)
        layout = self._layouts[topic]
        if layout is None or layout.itemsize != len(data):
            return None
        row = np.frombuffer(data, layout)[0]
        return Fields({name: row[name] for name in layout.names or ()}, t_us=t_us)

    def _layout(self, topic: str, first: bytes) -> np.dtype[np.void] | None:
        """None for a topic that another program has written, or of variable size."""
        try:
            types, name = self._log.types(topic)
            found = fixed_layout(types, name, int.from_bytes(first[12:16], "little"))
        except LogError:
            return None
        return None if found is None else found.dtype

    def _value(self, topic: str, t_us: int, data: bytes) -> dict[str, Any] | None:
        try:
            return {**decode(*self._log.types(topic), data), "t_us": t_us}
        except LogError:
            return None

    def _index(self) -> None:
        with self._log.reopened() as file:
            for number, chunk in enumerate(self._chunks):
                found = _indexed(file, chunk, self._topics)
                if not found:  # a chunk without an index
                    times = self._unpacked(number).times_ns
                    found = [(topic, int(t_ns[0]), int(t_ns[-1])) for topic, t_ns in times.items()]
                for topic, first_ns, last_ns in found:
                    before = self._first_ns.setdefault(topic, [])
                    before.append(max(first_ns, before[-1]) if before else first_ns)
                    self._numbers.setdefault(topic, []).append(number)
                    self._last_ns = max(self._last_ns, last_ns)

    def _unpacked(self, number: int) -> _Unpacked:
        """Of a damaged chunk, nothing."""
        kept = self._kept.get(number)
        if kept is not None:
            self._kept.move_to_end(number)
            return kept
        try:
            with self._log.reopened() as file:
                made = self._sorted(unpack(file, self._chunks[number]))
        except Damage:
            made = _Unpacked(b"", {}, {})
        self._kept[number] = made
        if len(self._kept) > KEPT_CHUNKS:
            self._kept.popitem(last=False)
        return made

    def _sorted(self, data: bytes) -> _Unpacked:
        found = find_messages(data)
        times_ns, spans = {}, {}
        for channel in np.unique(found.channels).tolist():
            mine = np.flatnonzero(found.channels == channel)
            mine = mine[np.argsort(found.log_times_ns[mine], kind="stable")]
            begins = found.starts[mine]
            topic = self._topics.get(channel, "")
            times_ns[topic] = found.log_times_ns[mine]
            spans[topic] = np.stack([begins + MESSAGE_HEAD_BYTES, begins + found.lengths[mine]], axis=1)
        return _Unpacked(data, times_ns, spans)


def _indexed(file: IO[bytes], chunk: ChunkRef, topics: Mapping[int, str]) -> list[tuple[str, int, int]]:
    """Topics of a chunk with their first and last times, by the index records behind it; empty without any."""
    found: list[tuple[str, int, int]] = []
    offset = chunk.offset + chunk.length
    while chunk.packed:
        file.seek(offset)
        head = file.read(_INDEX_HEAD.size)
        if len(head) < _INDEX_HEAD.size or head[0] != _MESSAGE_INDEX:
            break
        _, length, channel, size = _INDEX_HEAD.unpack(head)
        entries = file.read(size)
        if len(entries) < size or size % _ENTRY.size or not size:
            return []
        times = np.frombuffer(entries, "<u8")[::2]
        if channel in topics:
            found.append((topics[channel], int(times.min()), int(times.max())))
        offset += PREFIX_BYTES + length
    return found
