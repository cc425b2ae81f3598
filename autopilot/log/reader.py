"""Log reader: ``open_log(path)["/nav/state"]`` is a numpy structured array.

Fixed-size topics are gathered chunk by chunk and viewed with the dtype that the schema in the file gives; topics of
variable size are decoded message by message. Damage is skipped and named in ``Log.problems``.
"""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from autopilot.core.errors import LogError
from autopilot.core.names import did_you_mean
from autopilot.log.cdr import CdrLayout, Types, decode, fixed_layout, parse_definition, short_name
from autopilot.log.container import (
    MESSAGE,
    Contents,
    Damage,
    find_messages,
    index_from_chunks,
    read_contents,
    records,
    unpack,
)
from autopilot.log.description import ATTACHMENT, RUN_RECORD, RunDescription, from_json
from autopilot.log.message_table import Columns, columns_of_values, data_frame, flat_columns
from autopilot.log.message_table import MessageTable as MessageTable

_EPOCH_DIGITS = 20
"""A Unix time in nanoseconds has fewer digits than this (until the year 2286)."""
MOST_HZ = 1e6
"""Times are whole microseconds."""
_MESSAGE_HEAD = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")])


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a log.

    Attributes
    ----------
    type
        Message type, ``package/Name``.
    count
        Readable messages.
    """

    type: str
    count: int


@dataclass(frozen=True, slots=True)
class DecodedMessage:
    """A message of any type.

    Attributes
    ----------
    t_us
        Log time on the service's clock [us].
    value
        Field -> value: numbers, text, ``bytes``, lists, nested messages as dictionaries.
    """

    t_us: int
    value: dict[str, Any]


@dataclass(slots=True)
class _Raw:
    """Messages of one topic as they are in the file: record contents, all of one length or listed one by one."""

    blocks: list[NDArray[np.uint8]]
    singles: list[bytes]


def open_log(path: str | Path) -> "Log":
    """Open an MCAP log; a damaged one opens as far as it can be read.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Log
        Reads topics when they are asked for; :attr:`Log.problems` says what is damaged.

    Raises
    ------
    LogError
        There is no such file, or it is not MCAP.
    """
    return Log(Path(path))


CLOCKED = ("/in/tick", "/nav/state", "/sim/truth")
"""Topics with one message per tick, in the order of the ticks, for the check of the clock."""


class Log:
    """A log that is open for reading (:func:`open_log`).

    ``log["/nav/state"]`` is a topic of fixed-size messages as a :class:`~autopilot.log.message_table.MessageTable`;
    ``topic in log`` says whether it has messages. SI units, world NED, body FRD (docs/topics.md); times ``t_us`` are
    microseconds of the service's clock, which read zero at Unix time :attr:`epoch_ns`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.contents: Contents = read_contents(path)
        """Where things are in the file."""
        self._raw: dict[str, _Raw] = {}
        self._tables: dict[str, MessageTable] = {}
        self._clock_checked = False

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name; ``run`` is ours."""
        return self.contents.metadata

    @property
    def run(self) -> Mapping[str, str]:
        """The metadata record ``run``, empty if there is none."""
        return self.contents.metadata.get(RUN_RECORD, {})

    @property
    def attachments(self) -> Mapping[str, bytes]:
        return self.contents.attachments

    @cached_property
    def description(self) -> RunDescription | None:
        """``run.json``, None for a log without it."""
        data = self.contents.attachments.get(ATTACHMENT)
        return None if data is None else from_json(data, str(self.path))

    def lacks(self, what: str, remedy: str) -> LogError:
        """The error that it has not what is needed: for its damage, if there is any, else ``remedy`` says more."""
        if self.contents.problems:
            remedy = f"'log info' names the loss: {self.contents.problems[0]}"
        return LogError(f"{self.path}: has {what}; {remedy}")

    @property
    def problems(self) -> tuple[str, ...]:
        """Damage and missing parts, empty for a sound log. Chunks are checked when they are read (:meth:`verify`)."""
        return tuple(self.contents.problems)

    @cached_property
    def topics(self) -> Mapping[str, TopicInfo]:
        """Sorted by name."""
        found: dict[str, TopicInfo] = {}
        for number, channel in self.contents.channels.items():
            schema = self.contents.schemas.get(channel.schema_id)
            before = found.get(channel.topic)
            count = self.contents.counts[number] + (before.count if before else 0)
            found[channel.topic] = TopicInfo(short_name(schema.name) if schema else "", count)
        return dict(sorted(found.items()))

    @property
    def message_count(self) -> int:
        return sum(self.contents.counts.values())

    @property
    def duration_s(self) -> float:
        """Time between the first and the last message [s]."""
        return self.contents.duration_ns * 1e-9

    @cached_property
    def epoch_ns(self) -> int:
        """Unix time [ns] at which the service's clock read zero; without metadata, 0."""
        text = self.run.get("epoch_ns", "")
        return int(text) if text.isdecimal() and len(text) < _EPOCH_DIGITS else 0

    def __contains__(self, topic: object) -> bool:
        info = self.topics.get(topic) if isinstance(topic, str) else None
        return info is not None and info.count > 0

    def __iter__(self) -> Iterator[str]:
        """Topics that have messages."""
        return (topic for topic in self.topics if topic in self)

    def __getitem__(self, topic: str) -> MessageTable:
        """A topic of fixed-size messages.

        Parameters
        ----------
        topic
            Its name, for example ``/sim/truth``.

        Returns
        -------
        MessageTable
            (n,) one row per message, read once and kept.

        Raises
        ------
        LogError
            The topic is missing, damaged or of variable size (use :meth:`messages`).
        """
        if topic not in self._tables:
            self._tables[topic] = self._table(topic)
        return self._tables[topic]

    def get(self, topic: str) -> MessageTable | None:
        """A fixed-size topic, None if it has no messages.

        Returns
        -------
        MessageTable or None
            (n,) one row per message.

        Raises
        ------
        LogError
            The topic is damaged or of variable size.
        """
        if topic not in self:
            return None
        return self[topic]

    def align(self, topics: Sequence[str], rate_hz: float) -> dict[str, MessageTable]:
        """Fixed-size topics sampled on a common clock, from the last start to the first end (zero-order hold).

        Parameters
        ----------
        topics
            Their names.
        rate_hz
            Rate of the common clock [Hz].

        Returns
        -------
        dict
            Topic -> (n,) its last message at each time of the clock; ``t_us`` is the common time [us].

        Raises
        ------
        LogError
            A topic is missing, empty or of variable size, or they have no time in common.
        """
        if not 0.0 < rate_hz <= MOST_HZ or not topics or isinstance(topics, str):
            wanted = f"a list of topics and a rate above 0 Hz, {MOST_HZ:g} Hz at most"
            raise LogError(f"{self.path}: align() needs {wanted}, not {topics!r} and {rate_hz:g}")
        self.load(topics)
        tables = {topic: self[topic] for topic in topics}
        empty = [topic for topic, table in tables.items() if not len(table)]
        if empty:
            raise LogError(f"{self.path}: {', '.join(empty)} has no messages; leave it out of align()")
        times = {topic: np.sort(table["t_us"]) for topic, table in tables.items()}
        first, last = max(int(t[0]) for t in times.values()), min(int(t[-1]) for t in times.values())
        if first > last:
            raise LogError(f"{self.path}: {', '.join(topics)} have no time in common")
        grid = first + np.arange(int((last - first) * 1e-6 * rate_hz) + 1) * (1e6 / rate_hz)
        found = {}
        for topic, table in tables.items():
            ordered = table[np.argsort(table["t_us"], kind="stable")].view(MessageTable)
            rows = np.searchsorted(times[topic], grid, side="right") - 1
            found[topic] = ordered[rows].view(MessageTable)
            found[topic]["t_us"][:] = np.round(grid)
        return found

    def messages(self, topic: str) -> list[DecodedMessage]:
        """Every message of a topic of any type, decoded, in the order of the file.

        Returns
        -------
        list of DecodedMessage
            Empty for a topic without messages.

        Raises
        ------
        LogError
            The topic is missing, its schema is not ros2msg, or a message is damaged.
        """
        types, name = self.types(topic)
        out = []
        for log_time, data in self._raw_messages(topic):
            try:
                value = decode(types, name, data)
            except LogError as error:
                raise LogError(f"{self.path}: {topic}: {error}") from error
            out.append(DecodedMessage((log_time - self.epoch_ns) // 1000, value))
        return out

    def columns(self, topic: str) -> Columns:
        """Columns of a topic of any type, as they are exported.

        Returns
        -------
        dict
            Name -> one value per message: ``t_us`` [us], ``t_s`` [s], then the fields; arrays element by element
            (``pos_ned_m[0]``), nested fields by their path; of topics of variable size lists as JSON, bytes as their
            length.

        Raises
        ------
        LogError
            As :meth:`messages`.
        """
        try:
            return flat_columns(self[topic])
        except LogError:  # of variable size; where it is damaged, so are its messages
            messages = self.messages(topic)
        t_us = np.array([message.t_us for message in messages], dtype=np.int64)
        return columns_of_values(t_us, (message.value for message in messages))

    def to_pandas(self, topic: str) -> Any:
        """A topic of any type for pandas; its ``to_xarray()`` makes it one for xarray.

        Returns
        -------
        pandas.DataFrame
            :meth:`columns`, indexed by ``t_s`` [s].

        Raises
        ------
        LogError
            As :meth:`messages`, or pandas is not installed.
        """
        return data_frame(self.columns(topic))

    def raw_messages(self, topic: str) -> list[tuple[int, bytes]]:
        """Messages of a topic without decoding.

        Returns
        -------
        list of (int, bytes)
            Log time [ns, Unix] and CDR bytes.
        """
        return list(self._raw_messages(topic))

    def _raw_messages(self, topic: str) -> Iterator[tuple[int, bytes]]:
        self.load([topic])
        raw = self._raw[topic]
        for row in itertools.chain((row.tobytes() for block in raw.blocks for row in block), raw.singles):
            yield int.from_bytes(row[6:14], "little"), row[_MESSAGE_HEAD.itemsize :]

    def order(self, topics: Sequence[str]) -> list[int]:
        """File order of the messages of several topics (stamps do not give the order of arrival).

        Returns
        -------
        list of int
            Indices into ``topics``: the n-th 2 is the n-th message of ``topics[2]``.
        """
        place = {n: topics.index(c.topic) for n, c in self.contents.channels.items() if c.topic in topics}
        found: list[int] = []
        with self.reopened() as file:
            for chunk in self.contents.chunks:
                try:
                    data = unpack(file, chunk)
                except Damage:
                    continue  # the tables leave it out as well, and name it
                for opcode, start, length in records(data):
                    if opcode == MESSAGE and length >= _MESSAGE_HEAD.itemsize:
                        number = data[start] | data[start + 1] << 8
                        if number in place:
                            found.append(place[number])
        return found

    def load(self, topics: Iterable[str]) -> None:
        """Read several topics in one pass over the file; unknown topics are ignored."""
        missing = {topic for topic in topics if topic not in self._raw}
        wanted = {n: c.topic for n, c in self.contents.channels.items() if c.topic in missing}
        for topic in missing:
            self._raw[topic] = _Raw([], [])
        if wanted:
            self._read_chunks(wanted)

    def leave_out(self, topic: str, error: LogError) -> None:
        """Report a topic that cannot be read as a problem of the log."""
        self.contents.problems.append(f"{topic} is left out ({str(error).removeprefix(f'{self.path}: ')})")

    def verify(self) -> tuple[str, ...]:
        """Read and check every chunk; :attr:`topics` then counts the readable messages.

        Returns
        -------
        tuple of str
            All problems, empty for a sound log.
        """
        self._read_chunks({})
        if self.contents.problems:
            with self.reopened() as file:
                index_from_chunks(file, self.contents)
            self.__dict__.pop("topics", None)
        self.check_clock()
        return self.problems

    @contextmanager
    def reopened(self) -> Iterator[IO[bytes]]:
        """The file once more. LogError if it is gone meanwhile."""
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read any more ({error.strerror}); was it moved?") from error
        with file:
            yield file

    def check_clock(self) -> None:
        """Report time that goes back in a topic that is written in the order of time."""
        if self._clock_checked:
            return
        self._clock_checked = True
        self.load(CLOCKED)
        for topic in CLOCKED:
            try:
                t_us = self[topic]["t_us"].astype(np.int64) if topic in self else np.zeros(0, dtype=np.int64)
            except LogError:
                continue  # foreign or damaged: reported when the topic is read
            back = np.flatnonzero(np.diff(t_us) < 0)
            if len(back):
                at, by = 1e-6 * float(t_us[back[0]]), 1e-6 * float(t_us[back[0]] - t_us[back[0] + 1])
                text = (
                    f"{topic}: time goes back by {by:.3f} s after {at:.3f} s; figures over time are not to be trusted"
                )
                self.contents.problems.append(text)
                return

    def _read_chunks(self, wanted: Mapping[int, str]) -> None:
        bad = []
        with self.reopened() as file:
            for chunk in self.contents.chunks:
                try:
                    self._gather(unpack(file, chunk), wanted)
                except Damage as damage:
                    self.contents.problems.append(f"{damage}; its messages are left out")
                    bad.append(chunk)
        self.contents.chunks = [chunk for chunk in self.contents.chunks if chunk not in bad]

    def _gather(self, data: bytes, wanted: Mapping[int, str]) -> None:
        """Pick the wanted messages out of the records of one chunk."""
        found = find_messages(data)
        whole = np.frombuffer(data, np.uint8)
        for number in np.unique(found.channels).tolist():
            if number not in wanted:
                continue
            mine = found.channels == number
            starts, lengths = found.starts[mine], found.lengths[mine]
            raw, size = self._raw[wanted[number]], int(lengths[0])
            if (lengths == size).all() and not raw.singles:
                raw.blocks.append(whole[starts[:, None] + np.arange(size)])
            else:
                pairs = zip(starts.tolist(), lengths.tolist(), strict=True)
                raw.singles += [data[start : start + length] for start, length in pairs]

    def types(self, topic: str) -> tuple[Types, str]:
        """Message type of a topic with all that it uses. LogError if there is no such topic, or no such schema."""
        channel = next((c for c in self.contents.channels.values() if c.topic == topic), None)
        if channel is None:
            meant = did_you_mean(topic, self.topics)
            raise LogError(f"{self.path}: has no topic {topic}; {meant}it has {', '.join(self.topics) or 'none'}")
        schema = self.contents.schemas.get(channel.schema_id)
        if schema is None or schema.encoding != "ros2msg" or channel.message_encoding != "cdr":
            raise LogError(f"{self.path}: {topic} is not CDR with a ros2msg schema; only such topics can be decoded")
        return _parsed(schema.name, schema.data.decode()), schema.name

    def _table(self, topic: str) -> MessageTable:
        types, name = self.types(topic)
        self.load([topic])
        raw = self._raw[topic]
        if not raw.blocks and not raw.singles:
            return np.zeros(0, _columns(_layout(types, name, 4, self.path, topic))).view(MessageTable)
        widths = {block.shape[1] for block in raw.blocks}
        if raw.singles or len(widths) != 1:
            raise LogError(f"{self.path}: messages on {topic} differ in size; read them with messages()")
        rows = np.concatenate(raw.blocks) if len(raw.blocks) > 1 else raw.blocks[0]
        head = _MESSAGE_HEAD.itemsize
        frame_id_bytes = _frame_id_bytes(types, name, rows[0, head:].tobytes())
        layout = _layout(types, name, frame_id_bytes, self.path, topic)
        if rows.shape[1] != head + layout.dtype.itemsize:
            raise LogError(f"{self.path}: messages on {topic} do not fit their schema {name}; the log is damaged")
        body = np.ascontiguousarray(rows[:, head:]).view(layout.dtype)[:, 0]
        start = np.ascontiguousarray(rows[:, :head]).view(_MESSAGE_HEAD)[:, 0]
        table = np.zeros(len(rows), _columns(layout)).view(MessageTable)
        table["t_us"] = (start["log_time"].astype(np.int64) - self.epoch_ns) // 1000
        table["sequence"] = start["sequence"]
        for column in (table.dtype.names or ())[2:]:
            table[column] = body[column]
        return table


_parsed = lru_cache(maxsize=256)(parse_definition)
"""Logs of one version share their schemas."""


def _columns(layout: CdrLayout) -> np.dtype[np.void]:
    fields: Mapping[str, Any] = layout.dtype.fields or {}
    columns: list[Any] = [("t_us", "<i8"), ("sequence", "<u4")]
    columns += [(name, fields[name][0]) for name in layout.dtype.names or () if name not in ("header", "stamp")]
    return np.dtype(columns)


def _frame_id_bytes(types: Types, name: str, first: bytes) -> int:
    """Length of frame_id in the first message: the header, if any, is the first field of all our types."""
    fields = types[short_name(name)]
    has_header = bool(fields) and fields[0].type == "std_msgs/Header"
    return int.from_bytes(first[12:16], "little") if has_header else 4


def _layout(types: Types, name: str, frame_id_bytes: int, path: Path, topic: str) -> CdrLayout:
    layout = fixed_layout(types, name, frame_id_bytes) if 0 < frame_id_bytes < 256 else None
    if layout is None:
        raise LogError(f"{path}: {topic} ({name}) is of variable size; read it with messages() or to_pandas()")
    return layout
