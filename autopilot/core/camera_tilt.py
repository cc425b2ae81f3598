"""The tilt that carries the marker camera: reports of its angle, and whether pictures fit their calibration there.

Pose and direction of the camera in the body are calibrated at one angle (``camera_deg`` of the vehicle file). At any
other, pictures give a wrong position.
"""

import math
from collections.abc import Sequence

from autopilot.core import operator_messages as notices
from autopilot.core.operator_messages import OperatorText
from autopilot.core.samples import CameraTiltSample
from autopilot.core.vehicle import PayloadTable, Vehicle

TOLERANCE_RAD = math.radians(1.0)
"""A camera so far off counts as at its angle: the default of ``mounting_sigma_rad``, which is in the variance."""
REPORT_US = 200_000
"""An angle that does not change is reported so often."""
SILENT_US = 1_000_000
"""Without a report for so long the angle is not known."""


class TiltReports:
    """Samples of the tilt by the pulses at its servo: at once when they change, else at intervals."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._tilt = tilt = vehicle.tilt
        self._place = 0 if tilt is None else vehicle.payload.index(tilt)
        self._pulse_us = 0
        self._reported_us = -REPORT_US

    def of_outputs(self, t_us: int, pulses_us: Sequence[int]) -> tuple[CameraTiltSample, ...]:
        """The sample that is due when these are the commands of all outputs and nobody else moves the servo."""
        if self._tilt is None or not pulses_us:
            return ()
        return self.of(t_us, pulses_us[self._place] or self._tilt.start_us)

    def of(self, t_us: int, pulse_us: int) -> tuple[CameraTiltSample, ...]:
        """The sample that is due for a pulse; none for an output that is off."""
        same = pulse_us == self._pulse_us
        if self._tilt is None or pulse_us <= 0 or (same and t_us - self._reported_us < REPORT_US):
            return ()
        self._pulse_us, self._reported_us = pulse_us, t_us
        return (CameraTiltSample(t_us=t_us, angle_rad=self._tilt.angle_rad(pulse_us)),)


def off_rad(tilt: PayloadTable, sample: CameraTiltSample) -> float:
    """How far the camera is from where it was calibrated, upwards positive; 0 within the tolerance.

    A camera that does not tilt is never off.
    """
    if tilt.camera_deg is None:
        return 0.0
    away_rad = sample.angle_rad - math.radians(tilt.camera_deg)
    return 0.0 if abs(away_rad) <= TOLERANCE_RAD else away_rad  # NaN is off


def tilt_problem(tilt: PayloadTable | None, sample: CameraTiltSample | None, t_us: int) -> OperatorText | None:
    """Why pictures are not used, None while they are. ``sample``: the newest."""
    if tilt is None or tilt.camera_deg is None:
        return None
    if sample is None or t_us - sample.t_us > SILENT_US:
        return notices.CAMERA_TILT_UNKNOWN(channel=tilt.channel)
    if off_rad(tilt, sample) == 0.0:
        return None
    return notices.CAMERA_AWAY(now_deg=math.degrees(sample.angle_rad), wanted_deg=tilt.camera_deg)
