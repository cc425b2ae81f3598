"""Pictures that look right and are not of here and now, through the whole service: they never own the position."""

from typing import Any

import pytest

from tests.bench.picture_faults import DEADLINE_S
from tests.bench.sensor_faults import FaultFlight, FaultResult, fly_fault

CAMERA_WRONG, POSES_WRONG, HOLDS = "Camera wrong", "Poses wrong", "Failsafe HOLD: poses rejected"
"""With rendered pictures, and with the pose sensor."""
AT_S, LASTS_S, END_S = 8.4, 3.0, 14.0


def fly(kind: str, seed: int, sensors: str = "pose", end_s: float = END_S, **keys: Any) -> FaultResult:
    slower = {"sensors": {"camera": {"rate_hz": 15.0}}} if sensors == "camera" else None
    fault = {"kind": f"camera_{kind}", **keys}
    flight = FaultFlight(
        faults=(fault,), at_s=AT_S, lasts_s=LASTS_S, seed=seed, sensors=sensors, changes=slower, duration_s=end_s
    )
    return fly_fault(flight)


def honest(result: FaultResult) -> bool:
    return result.contacts == 0 and result.outside_s <= DEADLINE_S and not result.thrusters_blamed


def blamed(result: FaultResult, *names: str) -> bool:
    return any(text.startswith(names) for text in result.texts)


@pytest.mark.parametrize(
    ("kind", "seed", "keys"),
    [
        ("near_frozen", 2, {"noise_levels": 2.0}),
        ("repeated", 1, {"pictures": 15}),
        ("delayed", 4, {"delay_s": 1.0}),
        ("elsewhere", 3, {"offset_m": [0.6, -0.3, 0.0], "yaw_rad": 1.0}),
        ("elsewhere", 5, {"offset_m": [0.4, 0.4, 0.0], "yaw_rad": 0.3}),
    ],
)
def test_fixes_that_do_not_move_as_the_vehicle_name_the_camera(kind: str, seed: int, keys: dict[str, Any]) -> None:
    result = fly(kind, seed, **keys)
    assert honest(result), result
    assert result.resets <= 2, "there and back at most"
    assert blamed(result, POSES_WRONG) and blamed(result, HOLDS)
    assert not blamed(result, "Accelerometer", "Gyro"), result.texts
    assert result.back_s is not None and result.back_s < 2.0


def test_a_near_frozen_picture_moves_nothing_and_the_way_back_is_short() -> None:
    """Rendered pictures with two grey levels of noise: not equal to the last pixel, and still."""
    result = fly("near_frozen", 2, "camera", end_s=13.5, noise_levels=2.0)
    assert honest(result), result
    assert result.resets == 0 and result.worst_m < 0.15
    assert blamed(result, CAMERA_WRONG) and not blamed(result, "Accelerometer", "Gyro")
    assert result.back_s is not None and result.back_s < 2.0


@pytest.mark.parametrize(
    ("kind", "seed", "keys"),
    [
        ("mirrored", 2, {"across": "columns"}),
        ("half_frozen", 1, {"part": "left", "share": 0.6}),
        ("reflection", 1, {"strength": 0.6}),
    ],
)
def test_spoilt_pictures_give_no_other_place(kind: str, seed: int, keys: dict[str, Any]) -> None:
    result = fly(kind, seed, "camera", end_s=13.0, **keys)
    assert honest(result), result
    assert result.worst_m < 0.35 and not blamed(result, "Accelerometer", "Gyro")
    assert result.back_s is not None and result.back_s < 2.0
