"""Stills: the first picture exposed after the request, stored in the log and beside it.

PNG encoding and file writing are done by a background worker; the log takes the bytes when they are ready, in
lockstep after a fixed number of ticks.
"""

import shutil
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from autopilot.core.background import BackgroundTask, BackgroundWorker, Cancel
from autopilot.core.clock import TICK_US
from autopilot.core.errors import LogError
from autopilot.core.samples import CameraFrame
from autopilot.core.stills import CameraReport, StoredStill

DUE_TICKS = 5
"""Compressing a picture takes less than 50 ms."""
WAIT_US = 2_000_000
"""Timeout of a camera without pictures."""
SPACE_TICKS = 200
"""Interval of free space checks."""
KEEP_FREE_BYTES = 64 * 1024 * 1024
"""Free space on the disk that stills leave to the log."""
PNG_LEVEL = 1
"""Of nine: noise of a picture is not compressed further by more."""


class StillLog(Protocol):
    """Record of the stills taken (:class:`autopilot.run.recorder.RunRecorder`)."""

    @property
    def path(self) -> Path | None:
        """Path of the present log, None without one."""
        ...

    def still(self, exposure_us: int, png: bytes) -> None:
        """A picture for the present log."""
        ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Picture:
    """A still being written to the disk."""

    pixels: Any
    file: Path


class StillStore:
    """The runtime's end of :class:`autopilot.command.photographer.Photographer`. Called once per tick."""

    def __init__(self, log: StillLog, worker: BackgroundWorker, folder: Path) -> None:
        """``folder``: of all logs; paths for clients are below it."""
        self._log, self._worker, self._folder = log, worker, folder
        self._requested: deque[tuple[int, int]] = deque()
        """Number and time of what has been asked for and not been exposed."""
        self._writing: list[tuple[StoredStill, BackgroundTask[bytes]]] = []
        self._done: list[StoredStill] = []
        self._frame_us: int | None = None
        self._space: BackgroundTask[tuple[int, int]] | None = None
        self._total_bytes = self._free_bytes = 0
        self._space_tick = 0

    def take(self, t_us: int, frames: Sequence[CameraFrame]) -> tuple[StoredStill, ...]:
        """Assign pictures to requests; returns the results of earlier stills."""
        tick = t_us // TICK_US
        self._check_disk(tick)
        for frame in frames:
            self._frame_us = frame.t_us
            if self._requested and frame.t_us >= self._requested[0][1]:
                self._store(tick, self._requested.popleft()[0], frame)
        while self._requested and t_us - self._requested[0][1] > WAIT_US:
            index, _ = self._requested.popleft()
            self._fail(index, t_us, "camera delivers no picture")
        for still, task in self._writing:
            answer = task.poll(tick)
            if answer is None:
                continue
            if answer.error is not None or answer.value is None:
                self._fail(still.index, still.exposure_us, _reason(answer.error))
                continue
            self._log.still(still.exposure_us, answer.value)
            self._done.append(replace(still, size=len(answer.value)))
        self._writing = [(still, task) for still, task in self._writing if task.open]
        done, self._done = tuple(self._done), []
        return done

    def request(self, t_us: int, shots: Sequence[int]) -> None:
        """These are to be taken from now on."""
        self._requested += [(index, t_us) for index in shots]

    def report(self) -> CameraReport:
        """How camera and disk are doing."""
        return CameraReport(
            frame_us=self._frame_us,
            total_bytes=self._total_bytes,
            free_bytes=self._free_bytes,
            refusal=self._refusal(),
        )

    def _refusal(self) -> str:
        if self._log.path is None:
            return "no log is being written, arm first"
        if self._total_bytes and self._free_bytes < KEEP_FREE_BYTES:
            return "disk is full, erase old logs"
        return ""

    def _store(self, tick: int, index: int, frame: CameraFrame) -> None:
        log = self._log.path
        if log is None:
            self._fail(index, frame.t_us, "log has ended")
            return
        file = log.with_name(f"{log.stem}.still-{index:04d}.png")
        rows, columns = frame.image_bgr.shape[:2]
        still = StoredStill(
            index=index,
            exposure_us=frame.t_us,
            path=self._path_for_clients(file),
            width_px=int(columns),
            height_px=int(rows),
        )
        picture = _Picture(pixels=frame.image_bgr.copy(), file=file)
        self._writing.append((still, self._worker.submit(tick + DUE_TICKS, _store, picture)))

    def _path_for_clients(self, file: Path) -> str:
        """Path relative to the log directory, as :class:`autopilot.log.directory_reader.LogShelf` lists it."""
        try:
            return file.resolve().relative_to(self._folder.resolve()).as_posix()
        except ValueError:
            return file.name

    def _fail(self, index: int, t_us: int, problem: str) -> None:
        self._done.append(StoredStill(index=index, exposure_us=t_us, problem=problem))

    def _check_disk(self, tick: int) -> None:
        if self._space is not None:
            answer = self._space.poll(tick)
            if answer is not None:
                self._space = None
                if answer.value is not None:
                    self._total_bytes, self._free_bytes = answer.value
        elif tick >= self._space_tick:
            self._space_tick = tick + SPACE_TICKS
            log = self._log.path
            self._space = self._worker.submit(tick + 1, _space, self._folder if log is None else log.parent)


def _store(picture: _Picture, cancel: Cancel) -> bytes:
    """The PNG of a picture, which is also its file."""
    import cv2

    made, png = cv2.imencode(".png", picture.pixels, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    if not made:
        raise LogError("picture cannot be compressed")
    data = bytes(png.tobytes())
    partial_file = picture.file.with_name(picture.file.name + ".part")
    partial_file.write_bytes(data)
    partial_file.replace(picture.file)
    return data


def _space(folder: Path, cancel: Cancel) -> tuple[int, int]:
    usage = shutil.disk_usage(folder)
    return usage.total, usage.free


def _reason(error: Exception | None) -> str:
    if isinstance(error, OSError):
        return f"{error.strerror or error}"
    return str(error or "nothing came of it")
