"""A simulated obstacle sensor (e.g. an imaging sonar with tracker): tracks of moving and of unmapped obstacles.

Obstacles in the fence are not reported. Every report is a track with its own time, with noise on position and
velocity, and arrives after the latency.
"""

import math
from collections.abc import Sequence

import numpy as np

from autopilot.core.samples import ObstacleTrack
from autopilot.sitl.delayed import DelayedSensor
from autopilot.sitl.moving import MotionSample, MovingPath
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import CylinderObstacle, MovingObstacle, Obstacle
from autopilot.sitl.sensor_tables import ObstacleSensor
from autopilot.sitl.simulated_waters import moving_path


class SimObstacleSensor(DelayedSensor[ObstacleTrack]):
    """Looks at the truth at its own rate."""

    def __init__(self, sensor: ObstacleSensor, obstacles: Sequence[Obstacle], seed: int) -> None:
        super().__init__(sensor.rate_hz, sensor.latency_s)
        self._sensor = sensor
        self._rng = np.random.default_rng((seed, 30))
        self._seen: list[tuple[int, MovingPath | MotionSample, float]] = []
        for number, obstacle in enumerate(obstacles, start=1):
            if isinstance(obstacle, MovingObstacle):
                self._seen.append((number, moving_path(obstacle), obstacle.radius_m))
            elif isinstance(obstacle, CylinderObstacle) and obstacle.surprise:
                self._seen.append((number, MotionSample(obstacle.center_m, (0.0, 0.0)), obstacle.radius_m))

    @property
    def blind(self) -> bool:
        """There is nothing in this world that it would ever report."""
        return not self._seen

    def put(self, number: int, north_m: float, east_m: float, radius_m: float) -> None:
        """Move an obstacle away from its mapped position: from now on it is reported."""
        self._seen = [seen for seen in self._seen if seen[0] != number]
        self._seen.append((number, MotionSample((north_m, east_m), (0.0, 0.0)), radius_m))

    def begin(self, t_us: int) -> None:
        """Look from then on: so far there was nothing to be seen."""
        self._count = math.ceil(1e-6 * t_us * self._rate_hz) - 1
        self._taken()

    def observe(self, truth: Truth) -> None:
        self._taken()
        for number, path, radius_m in self._seen:
            motion = path.at(truth.t_us * 1e-6) if isinstance(path, MovingPath) else path
            noise = self._rng.standard_normal(4)
            center, velocity = np.array(motion.center_ned_m), np.array(motion.velocity_ned_m_s)
            if np.hypot(*(truth.pos_ned_m[:2] - center)) - radius_m > self._sensor.range_m:
                continue
            if velocity.any():
                velocity = velocity + self._sensor.sigma_velocity_m_s * noise[2:]
            report = ObstacleTrack(
                t_us=truth.t_us,
                track_id=number,
                pos_ned_m=center + self._sensor.sigma_m * noise[:2],
                vel_ned_m_s=velocity,
                radius_m=radius_m,
            )
            self._send(truth.t_us, 0.0, report)
