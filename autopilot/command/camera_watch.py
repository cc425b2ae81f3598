"""Camera faults reported to the operator: black, over-exposed, frozen, torn, foggy or no pictures.

Unusable pictures are rejected before the vision front end and arrive here as fault names. Dark, bright or foggy
pictures count only while no marker is detected in them.
"""

from collections.abc import Sequence

from autopilot.command.command_tuning import CAMERA_WATCH
from autopilot.core import operator_messages as notices
from autopilot.core.messages import Event
from autopilot.core.samples import FrameVerdict, MarkerSighting, PictureReport, Sample

FOGGY, SILENT = "foggy", "silent"
MESSAGES = {
    FrameVerdict.DARK.value: notices.CAMERA_DARK,
    FrameVerdict.BRIGHT.value: notices.CAMERA_BRIGHT,
    FrameVerdict.FLAT.value: notices.CAMERA_FLAT,
    FrameVerdict.TORN.value: notices.CAMERA_TORN,
    FrameVerdict.FROZEN.value: notices.CAMERA_FROZEN,
    FrameVerdict.WRONG_SIZE.value: notices.CAMERA_WRONG_SIZE,
    FrameVerdict.WRONG_TYPE.value: notices.CAMERA_WRONG_TYPE,
    FOGGY: notices.CAMERA_FOGGY,
    SILENT: notices.CAMERA_SILENT,
}
"""Message to the operator for each fault."""


class CameraWatch:
    """Reports changes of the camera's state."""

    def __init__(self) -> None:
        self.foggy = 0
        """Pictures that were too foggy for markers."""
        self._trouble: str | None = None
        """Fault reported to the operator, None without one."""
        self._now: str | None = None
        """State of all pictures since ``_since_us``; None = good."""
        self._since_us = 0
        self._count = 0
        self._last_us: int | None = None
        """Time of the last picture,"""
        self._markers_us: int | None = None
        """and the last one with markers."""

    def step(self, t_us: int, pictures: Sequence[PictureReport], samples: Sequence[Sample]) -> list[Event]:
        """Messages to the operator: each fault once, and its end."""
        if any(isinstance(sample, MarkerSighting) and sample.ids for sample in samples):
            self._markers_us = t_us
        for picture in pictures:
            self._last_us = t_us
            self._note(t_us, self._of(t_us, picture))
        silent = self._last_us is not None and t_us - self._last_us >= CAMERA_WATCH.silent_us
        if silent:
            self._note(t_us, SILENT)
        lasting = silent or (self._count >= CAMERA_WATCH.least and t_us - self._since_us >= CAMERA_WATCH.for_us)
        if not lasting or self._now == self._trouble:
            return []
        self._trouble = self._now
        if self._now is None:
            return [notices.CAMERA_WORKS.event(t_us)]
        return [MESSAGES[self._now].event(t_us)]

    def _note(self, t_us: int, trouble: str | None) -> None:
        if trouble != self._now:
            self._now, self._since_us, self._count = trouble, t_us, 0
        self._count += 1

    def _of(self, t_us: int, picture: PictureReport) -> str | None:
        if picture.verdict is not FrameVerdict.OK:
            return str(picture.verdict.value)
        if self._markers_us is not None and t_us - self._markers_us < CAMERA_WATCH.markers_us:
            return None
        if picture.white_fraction > CAMERA_WATCH.clipped_fraction:
            return FrameVerdict.BRIGHT.value
        if picture.black_fraction > CAMERA_WATCH.clipped_fraction:
            return FrameVerdict.DARK.value
        if picture.contrast < CAMERA_WATCH.fog_contrast:
            self.foggy += 1
            return FOGGY
        return None
