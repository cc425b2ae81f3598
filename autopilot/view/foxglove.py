"""Live topics for Foxglove, Lichtblick and other clients of the Foxglove WebSocket protocol.

The messages are those of the log: the same topics, schemas and bytes, made by the same code (:class:`RunLog`),
which writes to a queue here. A thread publishes them. Without subscribers the loop's cost is one check per tick.
The library is an extra: ``pip install 'underwater-autopilot[foxglove]'``.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from typing import Any

from autopilot.core.errors import ConfigError, LogError
from autopilot.core.messages import Inputs, LoopStats, Outputs
from autopilot.core.samples import CameraFrame
from autopilot.log.description import RunDescription
from autopilot.log.log_session import RunLog
from autopilot.log.record_table import TruthLike
from autopilot.log.schemas import ENCODING, MESSAGE_ENCODING, definition, ros_name
from autopilot.log.topics import AID_PREFIX, TOPICS, type_of
from autopilot.log.writer import NO_FILE, Payload, Work

QUEUE = 5000
"""Messages that wait for the thread, some seconds of them; the oldest go."""
POLL_S = 0.02
DESCRIBE_S = 1.0
PICTURE_US = 200_000


class FoxgloveServer:
    """The server of a process, on loopback. Runs attach to it one after the other."""

    def __init__(self, port: int) -> None:
        """ConfigError without the library, or if the port cannot be had; 0 = any port."""
        try:
            import foxglove
        except ImportError as error:
            raise ConfigError(
                "--foxglove needs foxglove-sdk; install it: pip install 'underwater-autopilot[foxglove]'"
            ) from error
        self._foxglove = foxglove
        self._context = foxglove.Context()
        self._subscribed: set[str] = set()
        self._queue: deque[tuple[str, int, Payload]] = deque(maxlen=QUEUE)
        self._channels: dict[str, Any] = {}
        for topic in TOPICS:
            self._channel(topic)
        try:
            self._server = foxglove.start_server(
                name="underwater-autopilot",
                host="127.0.0.1",
                port=port,
                context=self._context,
                server_listener=_Listener(self._subscribed),
            )
        except (RuntimeError, OSError) as error:
            raise ConfigError(f"--foxglove: port {port} cannot be had ({error}); give another one") from error
        self.port = int(self._server.port)
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="foxglove", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}"

    @property
    def watched(self) -> bool:
        return bool(self._subscribed)

    def attach(
        self,
        describe: Callable[[], RunDescription],
        revision: Callable[[], Hashable],
        truth: Callable[[], TruthLike | None] = lambda: None,
    ) -> "LiveLog":
        """The loop's end for a run. ``revision`` changes when ``describe`` may say something else."""
        return LiveLog(self, describe, revision, truth)

    def put(self, topic: str, time_ns: int, payload: Payload) -> None:
        """Queue a message, if it is subscribed."""
        if topic in self._subscribed:
            self._queue.append((topic, time_ns, payload))

    def close(self) -> None:
        """Send viewers away and end the thread."""
        self._closed = True
        self._thread.join(2.0)
        self._server.stop()

    def _channel(self, topic: str) -> None:
        kind = type_of(topic)
        schema = self._foxglove.Schema(name=ros_name(kind), encoding=ENCODING, data=definition(kind).encode())
        self._channels[topic] = self._foxglove.Channel(
            topic, schema=schema, message_encoding=MESSAGE_ENCODING, context=self._context
        )

    def _work(self) -> None:
        while not self._closed:
            time.sleep(POLL_S)
            while self._queue:
                topic, time_ns, payload = self._queue.popleft()
                try:
                    data = payload if isinstance(payload, bytes) else payload()
                except LogError:
                    continue  # a picture that cannot be compressed
                self._channels[topic].log(data, log_time=time_ns)

    def announce(self, topic: str) -> None:
        """A topic whose name is not known beforehand (one per aiding sensor)."""
        if topic not in self._channels:
            self._channel(topic)


class _Listener:
    """Tracks subscriptions; called on the library's threads."""

    def __init__(self, topics: set[str]) -> None:
        self._topics = topics
        self._counts: dict[str, int] = {}
        self._lock = threading.Lock()

    def on_subscribe(self, _client: Any, channel: Any) -> None:
        with self._lock:
            self._counts[channel.topic] = self._counts.get(channel.topic, 0) + 1
            self._topics.add(channel.topic)

    def on_unsubscribe(self, _client: Any, channel: Any) -> None:
        with self._lock:
            self._counts[channel.topic] = self._counts.get(channel.topic, 1) - 1
            if self._counts[channel.topic] <= 0:
                self._topics.discard(channel.topic)


class _Messages:
    path, dropped, queued, failure, cause, finished = NO_FILE, 0, (0, 0), None, "", False

    def __init__(self, server: FoxgloveServer, epoch_ns: int) -> None:
        self.epoch_ns = epoch_ns
        self._server = server

    @property
    def sink(self) -> "_Messages":
        return self

    def defer(self, topic: str, t_us: int, work: Work, messages: int, size: int) -> bool:
        work()
        return True

    def take_error(self) -> Exception | None:
        return None

    def write(self, topic: str, t_us: int, payload: Payload) -> None:
        if topic.startswith(AID_PREFIX):
            self._server.announce(topic)
        self._server.put(topic, self.epoch_ns + 1000 * t_us, payload)

    def write_packet(self, t_us: int, packet: bytes) -> None:
        """Ignored: a ``.tlog`` packet has no live channel."""

    def attach(self, name: str, t_us: int, data: Payload) -> None:
        """Ignored: only files have attachments."""

    def end(self) -> None: ...

    def close(self, timeout_s: float | None = None) -> None: ...


class LiveLog:
    """The loop's interface: a log that is not stored, packed while there are subscribers."""

    def __init__(
        self,
        server: FoxgloveServer,
        describe: Callable[[], RunDescription],
        revision: Callable[[], Hashable],
        truth: Callable[[], TruthLike | None],
    ) -> None:
        self._server, self._describe, self._revision, self._truth = server, describe, revision, truth
        self._log: RunLog | None = None
        self._described: Hashable = None
        self._describe_s = 0.0

    def tick(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        if not self._server.watched:
            self._log = None
            return
        log = self._described_log(inputs.t_us)
        log.inputs(inputs)
        for frame in frames:
            log.camera(frame)
        truth = self._truth()
        if truth is not None:
            log.truth(inputs.t_us, truth)
        log.outputs(outputs)

    def loop_stats(self, stats: LoopStats) -> None:
        if self._log is not None:
            self._log.loop(stats)

    def _described_log(self, t_us: int) -> RunLog:
        now_s = time.monotonic()
        log = self._log
        if log is not None and now_s < self._describe_s:
            return log
        self._describe_s = now_s + DESCRIBE_S
        revision = self._revision()
        if log is None:
            epoch_ns = time.time_ns() - 1000 * t_us
            log = self._log = RunLog(_Messages(self._server, epoch_ns), self._describe(), camera_period_us=PICTURE_US)
        elif revision != self._described:
            log.describe(t_us, self._describe(), {})
        self._described = revision
        return log
