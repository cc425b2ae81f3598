"""Pictures of a camera that is tilted away from where it was calibrated are not used (:mod:`.core.camera_tilt`)."""

from collections import deque
from collections.abc import Mapping

from autopilot.core import operator_messages as notices
from autopilot.core.camera_tilt import SILENT_US, off_rad, tilt_problem
from autopilot.core.samples import CameraTiltSample
from autopilot.core.vehicle import PayloadTable
from autopilot.estimator.monitor import Monitor

SETTLE_US = 500_000
"""Reports are of the pulse: a hobby servo takes up to so long for 90 deg, with a camera on it and in water."""
AHEAD_US = 100_000
"""A report comes so much later than the motion begins: 20 ms by MAVLink, the rest is margin."""


class TiltedCamera(Monitor):
    def __init__(self, tilt: PayloadTable) -> None:
        super().__init__()
        self._tilt = tilt
        self._off: deque[int] = deque(maxlen=256)
        """Times of reports with the camera away, the latest last."""
        self._newest: CameraTiltSample | None = None
        self._reported: bool | None = None
        """Whether the angle was known when pictures were last reported unused, None = they are used."""
        self._begin_us: int | None = None
        """Of pictures: the first report may come after them."""
        self._unused = 0

    def note(self, sample: CameraTiltSample) -> None:
        self._newest = sample
        if off_rad(self._tilt, sample) != 0.0:
            self._off.append(sample.t_us)

    def uses(self, picture_us: int, now_us: int) -> bool:
        """Whether a picture of that time can be used: the camera was at its angle, and had been for a while."""
        away = any(-AHEAD_US <= picture_us - off_us <= SETTLE_US for off_us in self._off)
        problem = tilt_problem(self._tilt, self._newest, now_us)
        known = self._newest is not None and now_us - self._newest.t_us <= SILENT_US
        if self._begin_us is None:
            self._begin_us = now_us
        if away or not known:
            self._unused += 1
            early = not known and now_us - self._begin_us <= SILENT_US
            if problem is not None and self._reported is not known and not early:
                self._reported = known
                self._texts.append(problem.text)
            return False
        if self._reported is not None:
            self._reported = None
            self._texts.append(notices.CAMERA_TILTED_BACK().text)
        return True

    def counts(self) -> Mapping[str, int]:
        return {"frames.tilted": self._unused}
