"""Common interface of the monitors: findings, their effect on the estimate's health, and detected values.

Some compare one sensor with the others (:mod:`.imu_monitor`, :mod:`.fix_trust`), some check common causes: the map
(:mod:`.map_monitor`), the camera's calibration (:mod:`.camera_monitor`), the estimate itself (:mod:`.evidence`).
"""

from collections.abc import Iterable, Mapping

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavDoubt
from autopilot.estimator.history import Node
from autopilot.estimator.remarks import Remarks

NOTHING: FloatArray = np.zeros(4)
NOTHING.flags.writeable = False


class Monitor(Remarks):
    """A watch that has found nothing."""

    def doubts(self, t_us: int, newest: Node) -> Iterable[NavDoubt]:
        """Findings against the estimate or its sensors."""
        return ()

    def systematic_variance(self, t_us: int, newest: Node) -> FloatArray:
        """(4,) variance of north, east, down, yaw in addition to the filter's; negative where more is known than the
        filter holds.
        """
        return NOTHING

    def counts(self) -> Mapping[str, int]:
        """Counts of findings, by name."""
        return {}


class MonitorFinding(Monitor):
    """State of a monitored sensor: used or rejected."""

    def __init__(self) -> None:
        super().__init__()
        self.since_us: int | None = None
        """When the sensor became suspect, None = it is trusted."""
        self.count = 0
        """How often it has."""

    @property
    def trusted(self) -> bool:
        """Whether the sensor is used."""
        return self.since_us is None

    def suspect(self, t_us: int) -> None:
        """From now on it is only watched."""
        self.since_us = t_us
        self.count += 1
