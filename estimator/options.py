"""Options of an estimator. The defaults are those of the vehicle."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorOptions:
    """Switches for studies and tests, and limits of the health flag."""

    compensate_latency: bool = True
    """False: late measurements are taken as if they were of now (to show what that costs)."""
    model_aid: bool = True
    """False: no current, as an estimator without a vehicle model has to do."""
    current_3d: bool = False
    """True: the vertical current is a state (Kalman filter only), found from heave thrust and a water-locked DVL."""
    gps: bool = True
    """False: fixes of GPS are passed over. The observer always does: it cannot find a velocity by fixes of metres."""
    dead_reckoning_after_s: float = 1.0
    """Time without a fix after which the estimate is called dead reckoning; of a slow source (1 Hz) more."""
    invalid_after_s: float = 5.0
    """Time without a fix after which the estimate is called invalid, unless the velocity over ground is measured."""
    watch_tilt: bool = True
    """False: an AHRS's tilt is not held against its own gyros and accelerometers (the shadow: the flown one does)."""
    stamps_every_s: float = 0.5
    """How often the stamps of pictures are held against gyro and accelerometer while nothing is amiss (the shadow:
    less often, the flown one has the same pictures)."""
    sigma_limit_m: float = 0.25
    """Standard deviation of the planar position beyond which the estimate is called invalid: nearly a body radius."""


DEFAULT_OPTIONS = EstimatorOptions()
