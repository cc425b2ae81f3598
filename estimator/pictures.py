"""Camera clock and image processing: poses from markers, ranges from the laser dot."""

from collections import deque
from dataclasses import replace

from autopilot.core.samples import LaserSample, PoseSample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.markers_pose import MarkerSolver


class Pictures:
    """Image processing of one estimator, shared by the sources that use images."""

    def __init__(self, vehicle: Vehicle, solver: MarkerSolver | None) -> None:
        """``solver``: None = no map, images give no poses."""
        self.solver = solver
        self._clock_us = 0 if vehicle.camera is None else round(1e6 * vehicle.camera.time_offset_s)
        self.late_us = 0
        """What else has been found to be taken off the stamps of pictures."""
        self._made: deque[PoseSample | LaserSample] = deque(maxlen=64)

    @property
    def offset_us(self) -> int:
        """Correction of the stamps of images [us]."""
        return self._clock_us - self.late_us

    def note_made(self, sample: PoseSample | LaserSample) -> None:
        """Store a result of an image for :meth:`take_made`, with corrected stamps."""
        self._made.append(replace(sample, t_us=sample.t_us - self.offset_us))

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        """Results of images since the last call, with the images' original stamps."""
        made = tuple(self._made)
        self._made.clear()
        return made

    def set_lens(self, focal_error: float, distortion_error: float) -> None:
        """From now on take the camera's focal length and distortion for too large by these shares."""
        if self.solver is not None:
            self.solver.set_lens(focal_error, distortion_error)

    def set_print(self, error: float) -> None:
        """From now on take the printed markers for larger than the map has them by this share."""
        if self.solver is not None:
            self.solver.set_print(error)
