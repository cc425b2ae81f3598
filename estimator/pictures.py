"""Camera clock and image processing: poses from markers, ranges from the laser dot."""

from collections import deque
from dataclasses import replace

from autopilot.core.samples import LaserSample, PoseSample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.markers_pose import MarkerSolver


class Pictures:
    """Of one estimator; shared by the sources that live on pictures."""

    def __init__(self, vehicle: Vehicle, solver: MarkerSolver | None) -> None:
        """``solver``: None = there is no map, pictures tell nothing."""
        self.solver = solver
        self._clock_us = 0 if vehicle.camera is None else round(1e6 * vehicle.camera.time_offset_s)
        self.late_us = 0
        """What else has been found to be taken off the stamps of pictures."""
        self._made: deque[PoseSample | LaserSample] = deque(maxlen=64)

    @property
    def offset_us(self) -> int:
        """What is to be added to the stamps of pictures."""
        return self._clock_us - self.late_us

    def note_made(self, sample: PoseSample | LaserSample) -> None:
        """Remember for :meth:`take_made` what a picture has given, stamped by our clock."""
        self._made.append(replace(sample, t_us=sample.t_us - self.offset_us))

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        """What was made of pictures since the last call, stamped as the pictures were."""
        made = tuple(self._made)
        self._made.clear()
        return made

    def set_focal(self, share: float) -> None:
        """From now on take the camera's focal length for too long by that share."""
        if self.solver is not None:
            self.solver.set_focal(share)
