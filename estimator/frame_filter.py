"""Plausibility check of images: one that cannot show the floor is rejected, with the reason, before marker detection.

A rejected image has no other effect: the filter gets no fix, and reports loss of vision if that lasts.
"""

import math

import numpy as np
from numpy.typing import NDArray

from autopilot.core.samples import CameraFrame, FrameVerdict, PictureReport
from autopilot.estimator.estimator_tuning import FRAME_FILTER


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
                white_fraction=int(self._levels[FRAME_FILTER.white_level :].sum()) / sparse.size,
                black_fraction=int(self._levels[: FRAME_FILTER.black_level + 1].sum()) / sparse.size,
            )
        self._reports.append(report)
        return verdict

    def take_reports(self) -> tuple[PictureReport, ...]:
        reports, self._reports = tuple(self._reports), []
        return reports

    def _verdict(self, frame: CameraFrame) -> FrameVerdict:
        image = frame.image_bgr
        if not isinstance(image, np.ndarray) or image.shape != self._shape:
            return FrameVerdict.WRONG_SIZE
        if image.dtype != np.uint8:
            return FrameVerdict.WRONG_TYPE
        sparse = np.ascontiguousarray(image[:: FRAME_FILTER.step_px, :: FRAME_FILTER.step_px, 1])
        levels = self._levels = np.bincount(sparse.ravel(), minlength=256)
        if quantile(levels, FRAME_FILTER.most) < FRAME_FILTER.dark_level:
            return FrameVerdict.DARK
        if quantile(levels, 1.0 - FRAME_FILTER.most) > FRAME_FILTER.bright_level:
            return FrameVerdict.BRIGHT
        there = np.flatnonzero(levels)
        if int(there[-1]) - int(there[0]) <= FRAME_FILTER.flat_levels:
            return FrameVerdict.FLAT
        tail = image[-max(2, round(FRAME_FILTER.torn_fraction * self._shape[0])) :: 2, :: FRAME_FILTER.step_px]
        if (tail == tail[-1, -1]).all():
            return FrameVerdict.TORN
        alike = self._before is not None and np.array_equal(self._before, sparse)
        self._before = sparse
        return FrameVerdict.FROZEN if alike else FrameVerdict.OK


def quantile(levels: NDArray[np.int64], fraction: float) -> float:
    """Quantile of pixel values from their histogram ``levels`` (256,), linear between two levels."""
    up_to = levels.cumsum()
    place = fraction * (int(up_to[-1]) - 1)
    first = math.floor(place)
    below, above = np.searchsorted(up_to, (first, min(first + 1, int(up_to[-1]) - 1)), side="right").tolist()
    return float(below + (above - below) * (place - first))
