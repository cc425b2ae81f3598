"""The MCAP writer: a bounded queue in front of one thread, so that the control loop never waits for a disk.

``write`` only appends to the queue. The thread packs chunks, compresses, flushes every second and calls fsync every
five; only it reads the wall clock. In real time a full queue drops messages and counts them, and even the file is
created by the thread (``beside``); in lockstep simulation (``lossless``) the caller waits instead and chunks end at
seconds of log time, so that the same run gives the same file, byte for byte.
"""

import errno
import os
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TypeAlias

from autopilot.core.disk import cause_of
from autopilot.core.errors import LogError
from autopilot.log.description import RUN_RECORD
from autopilot.log.lock import lock_exclusive
from autopilot.log.mcap_file import REPEAT_CHUNKS, McapFile
from autopilot.log.schemas import ENCODING, MESSAGE_ENCODING, PROFILE, definition, ros_name
from autopilot.log.topics import type_of

CHUNK_BYTES = 256 * 1024
FLUSH_NS = 500_000_000
"""Half of the maximum loss when the process is killed: on a busy machine the thread runs late."""
FSYNC_NS = 5_000_000_000
FIRST_EPOCH_NS = 1_000_000_000
"""Samples may be a little older than the clock's zero, and MCAP has no negative times."""
LAST_EPOCH_NS = 2**31 * 1_000_000_000 - 366 * 86_400 * 1_000_000_000
"""A year before builtin_interfaces/Time ends (2038)."""
QUEUE_MESSAGES = 20_000
"""About ten seconds of messages."""
QUEUE_BYTES = 64 * 1024 * 1024
POLL_S = 0.02
"""The thread empties the queue this often: one switch of threads for many messages."""
LIBRARY = "underwater-autopilot"
NO_FILE = Path()
"""Path of a log whose file is still being made."""

QOS_PROFILES = (
    "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n"
    "  deadline:\n    sec: 9223372036\n    nsec: 854775807\n"
    "  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n"
    "  liveliness: 1\n"
    "  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n"
    "  avoid_ros_namespace_conventions: false"
)
"""Channel metadata ``offered_qos_profiles`` as ros2 bag writes it: reliable, volatile, keep all."""

_MEDIA_TYPES = {".json": "application/json", ".toml": "application/toml", ".txt": "text/plain", ".plan": "text/plain"}

Payload: TypeAlias = bytes | Callable[[], bytes]
Work: TypeAlias = Callable[[], None]
"""Makes messages on the writer's thread and gives them to :attr:`LogWriter.sink`."""
_Item: TypeAlias = tuple[str, int, Payload, Work | None, int, int, Mapping[str, int] | None]
"""Topic, time [us], payload or, if there is any, work instead; how many messages and bytes in memory that is; messages
by topic that were dropped before it."""
MAX_ERRORS = 16
"""Errors in packing, kept until requested; beyond that the oldest is dropped."""
_TLOG = ""
"""Topic of a packet for the ``.tlog``."""
_ATTACHMENT = "attachment:"
"""Stands, with a name behind it, for the topic of an attachment that comes while the log is running."""


def _open_locked(path: Path) -> IO[bytes]:
    """An empty file at ``path``, locked. LogError if a running service is writing there."""
    file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o644), "wb")
    if not lock_exclusive(file):
        file.close()
        raise LogError(f"log {path}: another service is writing it; choose another name")
    file.truncate(0)
    return file


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LogHead:
    """Path and initial records of a log."""

    path: Path
    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes]


class LogWriter:
    """One MCAP file being written, with a ``.tlog`` beside it once there is MAVLink traffic."""

    def __init__(
        self,
        path: Path,
        *,
        epoch_ns: int,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        lossless: bool = False,
        queue_messages: int = QUEUE_MESSAGES,
        queue_bytes: int = QUEUE_BYTES,
    ) -> None:
        """Open ``path`` (an existing file is replaced) and write metadata and attachments.

        ``epoch_ns`` is the Unix time [ns] at which the service's clock read zero. LogError if the file cannot be made.
        """
        self._prepare(path, epoch_ns, lossless, queue_messages, queue_bytes)
        try:
            self._open(LogHead(path=path, metadata=metadata, attachments=attachments))
        except OSError as error:
            raise LogError(f"log {path}: cannot be written ({error.strerror}); choose another place") from error
        self._thread.start()

    @classmethod
    def beside(cls, head: Callable[[], LogHead], *, epoch_ns: int) -> "LogWriter":
        """A log whose file is created by the thread, ``head()`` included; messages written meanwhile are queued.
        An error in creating the file is in ``failure``.
        """
        writer = cls.__new__(cls)
        writer._prepare(NO_FILE, epoch_ns, False, QUEUE_MESSAGES, QUEUE_BYTES)
        writer._head = head
        writer._thread.start()
        return writer

    def _prepare(self, path: Path, epoch_ns: int, lossless: bool, queue_messages: int, queue_bytes: int) -> None:
        if not FIRST_EPOCH_NS <= epoch_ns < LAST_EPOCH_NS:
            raise LogError(f"log {path}: epoch_ns = {epoch_ns} is not a Unix time in nanoseconds that ROS can hold")
        self.path = path
        """Of a log that is made beside the loop: known once it is made."""
        self.epoch_ns = epoch_ns
        self._head: Callable[[], LogHead] | None = None
        self._file: IO[bytes] | None = None
        self._mcap: McapFile
        self._lossless = lossless
        self._limit_messages, self._limit_bytes = queue_messages, queue_bytes
        self._queue: deque[_Item] = deque()
        self._missed: dict[str, int] = {}
        """Messages by topic that were dropped since the last that was queued."""
        self._sequence: dict[str, int] = {}
        """Messages so far by topic; the thread's."""
        self._second = 0
        """Of log time that was reached; the thread's."""
        self._errors: deque[Exception] = deque(maxlen=MAX_ERRORS)
        self._count_in = self._count_out = self._bytes_in = self._bytes_out = 0
        self._dropped = self._lost = 0
        self._failure: str | None = None
        self._cause = ""
        self._closing = self._stopped = self._waiting = False
        self._wake, self._space = threading.Event(), threading.Event()
        self._tlog: IO[bytes] | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._thread = threading.Thread(target=self._run, name="log-writer", daemon=True)

    def _open(self, head: LogHead) -> None:
        """Create the file and write its initial records."""
        self.path = head.path
        head.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = _open_locked(head.path)
        head.path.with_suffix(".tlog").unlink(missing_ok=True)
        self._mcap = McapFile(self._file, CHUNK_BYTES, repeat_chunks=REPEAT_CHUNKS)
        self._mcap.start(PROFILE, LIBRARY)
        self._mcap.add_metadata(RUN_RECORD, {**head.metadata, "epoch_ns": str(self.epoch_ns)})
        for name, data in head.attachments.items():
            self._add_attachment(name, self.epoch_ns, data)
        self._mcap.flush()

    @property
    def dropped(self) -> int:
        """Messages lost so far: the queue was full, or the disk failed."""
        return self._dropped + self._lost

    @property
    def queued(self) -> tuple[int, int]:
        """Messages and bytes that wait for the thread."""
        return self._count_in - self._count_out, self._bytes_in - self._bytes_out

    @property
    def failure(self) -> str | None:
        """Why nothing is written any more, None while all is well."""
        return self._failure

    @property
    def cause(self) -> str:
        """The failure in two or three words for an operator, "" while all is well."""
        return self._cause

    @property
    def finished(self) -> bool:
        """Whether the thread has ended: after ``close`` or ``end``, once everything is on disk."""
        return self._stopped

    @property
    def sink(self) -> "WriterSink":
        """Where work that was deferred puts its messages."""
        return WriterSink(self._put)

    def write(self, topic: str, t_us: int, payload: Payload, size: int | None = None) -> None:
        """Queue one CDR message; never accesses the disk.

        ``payload`` may be a function that makes the bytes on the writer's thread (an image to compress); ``size``
        is then its memory until then. LogError for an undeclared topic.
        """
        if topic != _TLOG and not topic.startswith(_ATTACHMENT):
            type_of(topic)
        if size is None:
            size = len(payload) if isinstance(payload, bytes) else 0
        self._queue_up(topic, t_us, payload, None, 1, size)

    def defer(self, topic: str, t_us: int, work: Work, messages: int = 1, size: int = 0) -> bool:
        """Queue work for the writer's thread that makes about so many messages and holds so many bytes meanwhile.

        False = the queue is full: the work is dropped and counted as lost. ``topic`` is the one whose sequence
        numbers then show it, "" = none. Its data must not be modified afterwards. Exceptions go to
        :meth:`take_error`.
        """
        return self._queue_up(topic, t_us, b"", work, messages, size)

    def take_error(self) -> Exception | None:
        """The oldest error in deferred work that has not been taken, None without one."""
        return self._errors.popleft() if self._errors else None

    def _queue_up(self, topic: str, t_us: int, payload: Payload, work: Work | None, messages: int, size: int) -> bool:
        if self._closing or self._stopped or (self._is_full() and not self._wait_for_space()):
            self._dropped += messages
            self._missed[topic] = self._missed.get(topic, 0) + 1
            return False
        missed = None
        if self._missed:
            missed, self._missed = self._missed, {}
        self._count_in += messages
        self._bytes_in += size
        self._queue.append((topic, t_us, payload, work, messages, size, missed))
        return True

    def write_packet(self, t_us: int, packet: bytes) -> None:
        """Queue one MAVLink packet for the ``.tlog``."""
        self.write(_TLOG, t_us, packet)

    def attach(self, name: str, t_us: int, data: Payload) -> None:
        """Queue an attachment; for readers it replaces an earlier one of the same name."""
        self.write(_ATTACHMENT + name, t_us, data)

    def end(self) -> None:
        """No more messages: the thread writes the queue, the index and the footer. Does not wait."""
        self._closing = True
        self._wake.set()

    def close(self, timeout_s: float | None = None) -> None:
        """``end`` and wait for it. LogError if the disk failed, or did not answer in time. May be called again."""
        self.end()
        self._thread.join(timeout_s)
        if not self._stopped:
            raise LogError(f"log {self.path}: the disk does not answer; the log is not finished")
        if self._failure is not None:
            raise LogError(f"log {self.path}: {self._failure}; {self._lost} messages are lost")

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _is_full(self) -> bool:
        return (
            self._count_in - self._count_out >= self._limit_messages
            or self._bytes_in - self._bytes_out >= self._limit_bytes
        )

    def _wait_for_space(self) -> bool:
        """False = the message is to be dropped."""
        self._wake.set()
        while self._lossless and not self._stopped:
            self._space.clear()
            self._waiting = True
            if not self._is_full():
                self._waiting = False
                return True
            self._space.wait(POLL_S)
        return False

    def _run(self) -> None:
        try:
            self._write_until_closed()
        except Exception as error:
            self._fail(LogError(f"{type(error).__name__}: {error}"))
            raise
        finally:
            self._stopped = True

    def _write_until_closed(self) -> None:
        head = self._head
        if head is not None:
            self._guard(lambda: self._open(head()))
        flushed = synced = time.monotonic_ns()
        while True:
            self._wake.wait(POLL_S)
            last = self._closing
            self._wake.clear()
            self._drain()
            now = time.monotonic_ns()
            if not self._lossless and now - flushed >= FLUSH_NS and self._failure is None:
                flushed = now
                self._guard(self._flush)
            if now - synced >= FSYNC_NS and self._failure is None:
                synced = now
                self._guard(self._sync)
            if last:
                self._guard(self._finish)
                if self._file is not None:
                    self._guard(self._file.close)
                return

    def _drain(self) -> None:
        for _ in range(len(self._queue)):
            topic, t_us, payload, work, messages, size, missed = self._queue.popleft()
            for name, count in (missed or {}).items():
                self._sequence[name] = self._sequence.get(name, 0) + count
            if self._failure is None:
                try:
                    if work is None:
                        self._put(topic, t_us, payload)
                    else:
                        self._do(work)
                except (OSError, LogError) as error:
                    self._fail(error)
            if self._failure is not None:
                self._lost += messages
            self._count_out += messages
            self._bytes_out += size
            if self._waiting:
                self._space.set()

    def _do(self, work: Work) -> None:
        """Run deferred work. Only disk errors end a log: others lose the rest of that work."""
        try:
            work()
        except OSError:
            raise
        except Exception as error:  # noqa: BLE001 - the loop takes it, for its guard
            self._errors.append(error)

    def _guard(self, action: Callable[[], object]) -> None:
        try:
            action()
        except (OSError, LogError) as error:
            self._fail(error)

    def _fail(self, error: OSError | LogError) -> None:
        """The first failure of the disk ends writing and is reported by ``close``."""
        if self._failure is None:
            self._cause = cause_of(error)
            if isinstance(error, OSError):
                self._failure = f"cannot be written ({error.strerror}); free or change the disk"
            else:
                self._failure = str(error)

    def _put(self, topic: str, t_us: int, payload: Payload) -> None:
        """Write one message; on the thread."""
        if self._lossless and t_us // 1_000_000 > self._second:
            self._second = t_us // 1_000_000
            self._flush()
        data = payload if isinstance(payload, bytes) else payload()
        time_ns = self.epoch_ns + t_us * 1000
        channel = self._channels.get(topic)
        if channel is None:
            if topic == _TLOG:
                self._put_packet(time_ns, data)
                return
            if topic.startswith(_ATTACHMENT):
                self._add_attachment(topic.removeprefix(_ATTACHMENT), time_ns, data)
                return
            channel = self._channels[topic] = self._register(topic)
        sequence = self._sequence.get(topic, 0)
        self._sequence[topic] = sequence + 1
        self._mcap.add_message(channel, time_ns, data, sequence & 0xFFFFFFFF)

    def _put_packet(self, time_ns: int, packet: bytes) -> None:
        """A MAVLink packet for the ``.tlog``."""
        if self._tlog is None:
            self._tlog = self.path.with_suffix(".tlog").open("wb")
        self._tlog.write(struct.pack(">Q", time_ns // 1000) + packet)

    def _add_attachment(self, name: str, time_ns: int, data: bytes) -> None:
        media = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
        self._mcap.add_attachment(time_ns, time_ns, name, media, data)

    def _register(self, topic: str) -> int:
        kind = type_of(topic)
        name = ros_name(kind)
        schema = self._schemas.get(name)
        if schema is None:
            schema = self._schemas[name] = self._mcap.register_schema(name, ENCODING, definition(kind).encode())
        metadata = {"offered_qos_profiles": QOS_PROFILES}
        return self._mcap.register_channel(topic, MESSAGE_ENCODING, schema, metadata)

    def _flush(self) -> None:
        self._mcap.flush()
        if self._tlog is not None:
            self._tlog.flush()

    def _sync(self) -> None:
        assert self._file is not None
        self._file.flush()
        os.fsync(self._file.fileno())
        if os.name == "posix" and os.fstat(self._file.fileno()).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, "its file was deleted")

    def _finish(self) -> None:
        if self._failure is None:
            self._mcap.finish()
            self._sync()
        if self._tlog is not None:
            self._tlog.close()


class WriterSink:
    """The thread's end of a :class:`LogWriter`: messages go straight into the file."""

    def __init__(self, put: Callable[[str, int, Payload], None]) -> None:
        self._put = put

    def write(self, topic: str, t_us: int, payload: Payload) -> None:
        self._put(topic, t_us, payload)

    def write_packet(self, t_us: int, packet: bytes) -> None:
        """One MAVLink packet for the ``.tlog``."""
        self._put(_TLOG, t_us, packet)

    def attach(self, name: str, t_us: int, data: Payload) -> None:
        self._put(_ATTACHMENT + name, t_us, data)
