"""Interface of the runtime to the log: hands whole ticks to the writer's thread, which packs the messages.

Nothing is packed on the loop's thread (:mod:`autopilot.log.packer` does that). Inputs, outputs, truth and pictures
are passed by reference and must not be modified afterwards.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from autopilot.core.messages import Event, Inputs, LoopStats, Outputs
from autopilot.core.samples import CameraFrame
from autopilot.log.description import ATTACHMENT, RunDescription, to_json
from autopilot.log.packer import Packer, Sink
from autopilot.log.quota import flights
from autopilot.log.record_table import TruthLike
from autopilot.log.writer import LogHead, LogWriter, Payload

CAMERA_US = 500_000
TICK_MESSAGES, TICK_BYTES = 4, 4096
"""Messages per tick and their memory while queued, without those below;"""
SAMPLE_MESSAGES, SAMPLE_BYTES = 2, 512
"""one sample,"""
FRAME_MESSAGES, FRAME_BYTES = 2, 512
"""one datagram,"""
CONTROL_MESSAGES, CONTROL_BYTES = 2, 16_384
"""one control step."""


def log_path(folder: Path, start_ns: int, *, last: bool = False) -> Path:
    """``<folder>/YYYY-MM-DD/HH_MM_SS.mcap`` (UTC) for a log that starts then; a free name if that is taken.

    ``last``: in the order of names behind all flights that are there, also if the clock has been set back.
    """
    start = datetime.fromtimestamp(start_ns // 1_000_000_000, UTC)
    day, time = start.strftime("%Y-%m-%d"), start.strftime("%H_%M_%S")
    newest = flights(folder)[-1:] if last else []
    if newest and newest[0].order >= (day, time, 1):
        day, time, number = newest[0].order
        return folder / day / f"{time}_{number + 1}.mcap"
    return free_path(folder / day / f"{time}.mcap")


def free_path(path: Path) -> Path:
    """``path``, or with a number behind its stem if that is taken."""
    free, number = path, 1
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}_{number}{path.suffix}")
    return free


def open_run_log(
    path: Path,
    *,
    epoch_ns: int,
    description: RunDescription,
    metadata: Mapping[str, str],
    attachments: Mapping[str, bytes],
    lossless: bool,
    camera_period_us: int | None = CAMERA_US,
) -> "RunLog":
    """A log of one run with its description attached. LogError if the file cannot be made."""
    writer = LogWriter(
        path,
        epoch_ns=epoch_ns,
        metadata=metadata,
        attachments={ATTACHMENT: to_json(description), **attachments},
        lossless=lossless,
    )
    return RunLog(writer, description, camera_period_us=camera_period_us)


def open_run_log_beside(
    head: Callable[[], LogHead],
    *,
    epoch_ns: int,
    description: RunDescription,
    camera_period_us: int | None = CAMERA_US,
) -> "RunLog":
    """The same where time does not wait: ``head()`` and the file are made beside the loop, failures show later.

    ``head()`` leaves ``run.json`` out. Where the disk does not follow, messages are dropped and counted.
    """

    def described() -> LogHead:
        given = head()
        return replace(given, attachments={ATTACHMENT: to_json(description), **given.attachments})

    writer = LogWriter.beside(described, epoch_ns=epoch_ns)
    return RunLog(writer, description, camera_period_us=camera_period_us)


class MessageSink(Protocol):
    """Where the messages of a log go: a file, or viewers."""

    epoch_ns: int

    @property
    def path(self) -> Path: ...
    @property
    def dropped(self) -> int: ...
    @property
    def queued(self) -> tuple[int, int]: ...
    @property
    def failure(self) -> str | None: ...
    @property
    def cause(self) -> str: ...
    @property
    def finished(self) -> bool: ...
    @property
    def sink(self) -> Sink: ...
    def defer(self, topic: str, t_us: int, work: Callable[[], None], messages: int, size: int) -> bool: ...
    def take_error(self) -> Exception | None: ...
    def end(self) -> None: ...
    def close(self, timeout_s: float | None = None) -> None: ...


class LoggedTruth(TruthLike, Protocol):
    """The part of a simulated vehicle's truth that is logged."""

    @property
    def contact_count(self) -> int:
        """Contacts since the start."""
        ...

    @property
    def contact_depth_m(self) -> float:
        """Deepest penetration at present."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SimulationRecord:
    """Ground truth of a simulated vehicle."""

    truth: LoggedTruth
    payload_levels: tuple[float, ...]
    """Where each thing that it carries is, 0 to 1; in the order of the vehicle file."""


class RunLog:
    """One log, fed tick by tick.

    A tick is given whole (:meth:`tick`), or in its order: ``inputs``, ``camera``, ``truth`` in simulation, ``outputs``.
    """

    def __init__(
        self, writer: MessageSink, description: RunDescription, *, camera_period_us: int | None = CAMERA_US
    ) -> None:
        """``camera_period_us``: time between logged images, None = no images."""
        self.writer = writer
        self._packer = Packer(writer.sink, writer.epoch_ns, description)
        self._camera_period_us = camera_period_us
        self._camera_us: int | None = None
        """Time of the last logged image."""
        self._lost = False
        """The last data did not fit into the queue."""

    def close(self, timeout_s: float | None = None) -> None:
        """Finish the file and wait for it. LogError if the disk has failed or times out."""
        self.writer.close(timeout_s)

    def describe(self, t_us: int, description: RunDescription, attachments: Mapping[str, Payload]) -> None:
        """A new description with its attachments (plans changed since the log began); readers use the last."""
        self._hand_over("", t_us, lambda: self._packer.describe(t_us, description, attachments))

    def tick(
        self,
        inputs: Inputs,
        outputs: Outputs,
        frames: Sequence[CameraFrame] = (),
        world: SimulationRecord | None = None,
    ) -> None:
        """A whole tick: inputs and outputs of ``step``, pictures, and the simulated world."""
        t_us, packer = inputs.t_us, self._packer
        pictures = [frame for frame in frames if self._due(frame)] if frames else ()

        def pack() -> None:
            packer.inputs(inputs)
            for frame in pictures:
                packer.camera(frame)
            if world is not None:
                truth = world.truth
                packer.truth(t_us, truth)
                packer.contact(t_us, truth.contact_count, truth.contact_depth_m)
                packer.payload_truth(t_us, world.payload_levels)
            packer.outputs(outputs)

        messages, size = _queue_size(len(inputs.samples), len(inputs.mavlink_rx) + len(outputs.mavlink_tx))
        messages += TICK_MESSAGES
        if outputs.control is not None:
            messages, size = messages + CONTROL_MESSAGES, size + CONTROL_BYTES
        for frame in pictures:
            size += frame.image_bgr.nbytes
        self._hand_over("/in/tick", t_us, pack, messages, size)

    def inputs(self, inputs: Inputs) -> None:
        messages, size = _queue_size(len(inputs.samples), len(inputs.mavlink_rx))
        self._hand_over("/in/tick", inputs.t_us, lambda: self._packer.inputs(inputs), 1 + messages, size)

    def camera(self, frame: CameraFrame) -> None:
        """An image, reduced to the camera's log rate and compressed on the writer's thread."""
        if self._due(frame):
            self._hand_over("/in/camera", frame.t_us, lambda: self._packer.camera(frame), 2, frame.image_bgr.nbytes)

    def still(self, exposure_us: int, png: bytes) -> None:
        """A still in full size, as a PNG; its metadata come with ``Outputs.stills``."""
        self._hand_over("/payload/image", exposure_us, lambda: self._packer.still(exposure_us, png), size=len(png))

    def truth(self, t_us: int, truth: TruthLike) -> None:
        self._hand_over("/sim/truth", t_us, lambda: self._packer.truth(t_us, truth), 2, TICK_BYTES)

    def contact(self, t_us: int, count: int, penetration_m: float) -> None:
        """Contacts of the simulated hull begun so far and the deepest penetration of now, once per tick."""
        self._hand_over("/sim/contact", t_us, lambda: self._packer.contact(t_us, count, penetration_m))

    def payload_truth(self, t_us: int, levels: tuple[float, ...]) -> None:
        """Where the simulated vehicle's equipment is, once per tick."""
        self._hand_over("", t_us, lambda: self._packer.payload_truth(t_us, levels))

    def loop(self, stats: LoopStats) -> None:
        self._hand_over("/sys/loop", stats.t_us, lambda: self._packer.loop(stats))

    def event(self, event: Event) -> None:
        """An event from outside ``step`` (``Outputs.events`` are written by ``outputs``)."""
        self._hand_over("/rosout", event.t_us, lambda: self._packer.event(event))

    def outputs(self, outputs: Outputs) -> None:
        messages, size = _queue_size(0, len(outputs.mavlink_tx))
        size += 0 if outputs.control is None else CONTROL_BYTES
        self._hand_over(
            "/nav/state", outputs.t_us, lambda: self._packer.outputs(outputs), TICK_MESSAGES + messages, size
        )

    def _due(self, frame: CameraFrame) -> bool:
        """Whether the image is one that is logged."""
        period_us, last_us = self._camera_period_us, self._camera_us
        if period_us is None or (last_us is not None and frame.t_us - last_us < period_us):
            return False
        self._camera_us = frame.t_us
        return True

    def _hand_over(self, topic: str, t_us: int, work: Callable[[], None], messages: int = 1, size: int = 0) -> None:
        """Queue for the thread. ``topic`` gets a gap in its sequence numbers when the queue is full; "" = none does."""
        if self._lost:
            work = _both(self._packer.after_loss, work)
        self._lost = not self.writer.defer(topic, t_us, work, messages, size)


def _queue_size(samples: int, datagrams: int) -> tuple[int, int]:
    """Messages and bytes that a tick with these inputs takes in the queue, beside those of the tick itself."""
    messages = SAMPLE_MESSAGES * samples + FRAME_MESSAGES * datagrams
    return messages, TICK_BYTES + SAMPLE_BYTES * samples + FRAME_BYTES * datagrams


def _both(first: Callable[[], None], second: Callable[[], None]) -> Callable[[], None]:
    def work() -> None:
        first()
        second()

    return work
