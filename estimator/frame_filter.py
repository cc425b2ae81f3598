"""The filter for pictures: what cannot be a picture of the floor is refused by name before anybody looks for markers.

A refused picture costs nothing else: the filter gets no fix, and says that it is blind when that lasts.
"""

import math

import numpy as np
from numpy.typing import NDArray

from autopilot.core.samples import CameraFrame, FrameVerdict, PictureReport

STEP_PX = 8
"""Every eighth pixel of every eighth row is looked at: 4800 of an image of 640 x 480."""
DARK_LEVEL, BRIGHT_LEVEL = 6.0, 249.0
"""Grey levels: if nine tenths of the pixels lie below (above), the lens is covered or the exposure is lost."""
WHITE_LEVEL, BLACK_LEVEL = 250, 8
"""Grey levels from which on (up to which) a pixel says nothing."""
MOST = 0.9
FLAT_LEVELS = 3
"""An image whose levels all lie within so many shows nothing, not even noise."""
TORN_SHARE = 0.05
"""An image of which this share of rows, up from the bottom, is one single colour has not arrived whole."""


class FrameFilter:
    """Looks at each picture once, in the order in which they come."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self._shape = (height_px, width_px, 3)
        self._before: NDArray[np.uint8] | None = None
        self._levels: NDArray[np.int64] = np.zeros(256, dtype=np.int64)
        """Of the last picture: how many of the pixels that are looked at have each grey level."""
        self.counts = dict.fromkeys(FrameVerdict, 0)
        self._reports: list[PictureReport] = []

    def judge(self, frame: CameraFrame) -> FrameVerdict:
        """Verdict of one picture, counted."""
        verdict = self._verdict(frame)
        self.counts[verdict] += 1
        report = PictureReport(t_us=frame.t_us, verdict=verdict)
        if verdict is FrameVerdict.OK:
            sparse = self._before
            assert sparse is not None
            steps = np.diff(sparse.astype(np.int16), axis=1)
            report = PictureReport(
                t_us=frame.t_us,
                verdict=verdict,
                contrast=float(steps.std()) * math.sqrt(0.5),
                white_share=int(self._levels[WHITE_LEVEL:].sum()) / sparse.size,
                black_share=int(self._levels[: BLACK_LEVEL + 1].sum()) / sparse.size,
            )
        self._reports.append(report)
        return verdict

    def take_reports(self) -> tuple[PictureReport, ...]:
        """What was judged since the last call."""
        reports, self._reports = tuple(self._reports), []
        return reports

    def _verdict(self, frame: CameraFrame) -> FrameVerdict:
        image = frame.image_bgr
        if not isinstance(image, np.ndarray) or image.shape != self._shape:
            return FrameVerdict.WRONG_SIZE
        if image.dtype != np.uint8:
            return FrameVerdict.WRONG_TYPE
        sparse = np.ascontiguousarray(image[::STEP_PX, ::STEP_PX, 1])
        levels = self._levels = np.bincount(sparse.ravel(), minlength=256)
        if quantile(levels, MOST) < DARK_LEVEL:
            return FrameVerdict.DARK
        if quantile(levels, 1.0 - MOST) > BRIGHT_LEVEL:
            return FrameVerdict.BRIGHT
        there = np.flatnonzero(levels)
        if int(there[-1]) - int(there[0]) <= FLAT_LEVELS:
            return FrameVerdict.FLAT
        tail = image[-max(2, round(TORN_SHARE * self._shape[0])) :: 2, ::STEP_PX]
        if (tail == tail[-1, -1]).all():
            return FrameVerdict.TORN
        alike = self._before is not None and np.array_equal(self._before, sparse)
        self._before = sparse
        return FrameVerdict.FROZEN if alike else FrameVerdict.OK


def quantile(levels: NDArray[np.int64], share: float) -> float:
    """What this share of the pixels counted in ``levels`` (256,) does not exceed, linear between two of them."""
    up_to = levels.cumsum()
    place = share * (int(up_to[-1]) - 1)
    first = math.floor(place)
    below, above = np.searchsorted(up_to, (first, min(first + 1, int(up_to[-1]) - 1)), side="right").tolist()
    return float(below + (above - below) * (place - first))
