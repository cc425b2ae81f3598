"""The type of what makes estimators in tests, and the vehicle that they fly."""

from collections.abc import Callable

import msgspec

from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.estimator.engine import AidedEstimator

Make = Callable[..., AidedEstimator]
"""(options, markers) -> estimator; both may be left out."""


def with_camera(vehicle: Vehicle, **changes: object) -> Vehicle:
    """Other keys of its ``[camera]``."""
    return msgspec.structs.replace(vehicle, camera=msgspec.structs.replace(vehicle.eye, **changes))


def calibrated() -> Vehicle:
    """An LBV150 whose calibration leaves nothing open but the focal length: what the filter says is its own error."""
    plain = load_vehicle("lbv150")
    assert plain.laser is not None
    vehicle = msgspec.structs.replace(plain, laser=msgspec.structs.replace(plain.laser, direction_sigma_rad=0.0))
    exact: dict[str, object] = {"time_offset_sigma_s": 0.0, "focal_sigma": 0.0, "distortion_sigma": 0.0}
    return with_camera(vehicle, position_sigma_m=(0.0,) * 3, mounting_sigma_rad=(0.0,) * 3, **exact)
