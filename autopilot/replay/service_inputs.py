"""Logged inputs of the whole service, tick by tick, bit-identical (:class:`autopilot.core.messages.Inputs`)."""

import base64
from collections import defaultdict
from collections.abc import Generator, Iterator, Sequence
from typing import Any

from autopilot.core.messages import Inputs
from autopilot.core.samples import Sample
from autopilot.log.packing.record_values import ALL_LINKS
from autopilot.log.packing.step_notes import EMPTY, LatchedNotes, StepNotes, inputs_with, unpack
from autopilot.log.reader import Log, MessageTable
from autopilot.replay.inputs import SAMPLES, TICK, require_start

NOTES = "/in/step"
BYTES = "/in/mavlink"


class ServiceInputs:
    """Iterator over the logged :class:`autopilot.core.messages.Inputs`.

    Raises
    ------
    LogError
        The log does not hold the service's inputs.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        if TICK not in log:
            raise log.lacks(f"no messages on {TICK}, which replay needs", "record the run with this version")
        # What stands below /nav/ was made of a sample by the service, which makes it again.
        inputs = (topic for topic in (NOTES, *SAMPLES) if topic.startswith("/in/"))
        self._topics = [TICK, *(topic for topic in inputs if topic in log)]
        log.load([*self._topics, BYTES])
        require_start(log)
        self._tables: list[MessageTable | None] = [log[topic] if topic != NOTES else None for topic in self._topics]
        self._notes = log.messages(NOTES) if NOTES in log else []
        self._streams = _streams(log)
        self._standing = LatchedNotes()
        self.stopped = ""
        """Why there are no inputs after the last tick, "" at the end of a log that is whole."""

    def __iter__(self) -> Iterator[Inputs]:
        """Every tick in turn, until the end or the first incomplete tick (reason in ``stopped``)."""
        tick: Any = None
        samples: list[Sample] = []
        notes = EMPTY
        last_us = 0
        positions = [0] * len(self._topics)
        for number in self._log.order(self._topics):
            at, topic = positions[number], self._topics[number]
            positions[number] += 1
            if topic == NOTES:
                text = self._notes[at].value["data"]
                notes = unpack(text, f"{self._log.path}: {NOTES} at {1e-6 * self._notes[at].t_us:.2f} s")
                continue
            table = self._tables[number]
            assert table is not None
            row = table[at]
            if topic != TICK:
                samples.append(SAMPLES[topic](row))
                continue
            if tick is not None and not (yield from self._whole(tick, samples, notes, last=False)):
                return
            if int(row["t_us"]) <= last_us:
                self.stopped = f"time goes back from {1e-6 * last_us:.2f} s to {1e-6 * int(row['t_us']):.2f} s"
                return
            tick, samples, notes, last_us = row, [], EMPTY, int(row["t_us"])
        if tick is not None:
            yield from self._whole(tick, samples, notes, last=True)

    def _whole(
        self, tick: Any, samples: Sequence[Sample], notes: StepNotes, *, last: bool
    ) -> Generator[Inputs, None, bool]:
        """The inputs of a tick, and whether all messages of the tick are there."""
        t_us = int(tick["t_us"])
        missing = int(tick["samples"]) - len(samples)
        frames = int(tick["frames"]) - len(notes.rx)
        if missing or frames:
            what = f"{missing} of the samples at" if missing else "the notes of its datagrams at"
            what = what if missing >= 0 else f"the tick of {-missing} samples after"
            end = " (the log ends there)" if last else ""
            self.stopped = f"{what} {1e-6 * t_us:.2f} s {'are' if frames else 'is'} missing{end}"
            return False
        given = Inputs(
            t_us=t_us, samples=tuple(samples), overruns=int(tick["overruns"]), cpu_load=float(tick["cpu_load"])
        )
        yield inputs_with(given, notes, self._datagrams(notes), self._standing)
        return True

    def _datagrams(self, notes: StepNotes) -> tuple[bytes, ...]:
        """Received bytes, with a substitute for each key that was removed."""
        found = []
        for number, datagram in enumerate(notes.rx):
            data = self._streams[datagram.link, datagram.client].take(datagram.length)
            for key in reversed([key for key in notes.keys if key.datagram == number]):
                data = data[: key.offset] + base64.b64decode(key.packet) + data[key.offset :]
            found.append(data)
        return tuple(found)


class _ClientBytes:
    def __init__(self) -> None:
        self.data = bytearray()
        self._at = 0
        self._owed = 0

    def take(self, length: int) -> bytes:
        """The next ``length`` bytes, less those that earlier calls have taken too many."""
        length += self._owed
        self._owed = min(length, 0)
        piece = bytes(self.data[self._at : self._at + max(length, 0)])
        self._at += len(piece)
        return piece + bytes(max(length, 0) - len(piece))  # the beginning of a packet that never ended


def _streams(log: Log) -> dict[tuple[int, int], _ClientBytes]:
    streams: dict[tuple[int, int], _ClientBytes] = defaultdict(_ClientBytes)
    table = log.get(BYTES)
    for row in () if table is None else table:
        link = int(row["link"])
        streams[-1 if link == ALL_LINKS else link, int(row["client"])].data += row["data"][
            : int(row["length"])
        ].tobytes()
    return streams
