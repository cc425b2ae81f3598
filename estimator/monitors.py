"""The monitors of one estimator and their combined findings."""

from typing import NamedTuple

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavDoubt
from autopilot.estimator.camera_monitor import CameraMonitor
from autopilot.estimator.evidence import Evidence
from autopilot.estimator.fix_trust import FixTrust
from autopilot.estimator.history import Node
from autopilot.estimator.imu_monitor import ImuMonitor
from autopilot.estimator.map_monitor import MapMonitor
from autopilot.estimator.monitor import NOTHING, Monitor
from autopilot.estimator.tilted_camera import TiltedCamera


class Monitors(NamedTuple):
    """In the order in which they are asked."""

    evidence: Evidence
    imu: ImuMonitor
    camera: CameraMonitor
    map: MapMonitor | None
    """None without a map."""
    fixes: FixTrust
    """Of the camera's poses."""
    tilted: TiltedCamera | None
    """None where the camera is fixed."""

    @property
    def all(self) -> tuple[Monitor, ...]:
        return tuple(each for each in self if each is not None)

    def doubts(self, t_us: int, newest: Node) -> frozenset[NavDoubt]:
        """Findings against the estimate or its sensors."""
        return frozenset([doubt for each in self if each is not None for doubt in each.doubts(t_us, newest)])

    def systematic_variance(self, t_us: int, newest: Node) -> FloatArray:
        """(4,) variance of north, east, down, yaw in addition to the filter's; negative where more is known than the
        filter holds.
        """
        more = NOTHING
        for each in self:
            found = NOTHING if each is None else each.systematic_variance(t_us, newest)
            if found is not NOTHING:
                more = more + found
        return more
