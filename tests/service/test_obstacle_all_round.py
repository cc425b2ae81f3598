"""A report of something so large that the vehicle would be deep inside of it (found by the fuzzer: an AIS ship of 97 m
radius over the tank had a vehicle that fled from it press against a wall)."""

from typing import Any

import numpy as np
import pytest
from piloted_world import PilotedWorld
from pymavlink.dialects.v20 import development as mav

PLACE = (1.9, -1.1)


def ship(size_m: int, north_m: float = 0.0, speed_cm_s: int = 0) -> Any:
    """AIS_VESSEL, as long as wide, about the tank's origin."""
    half = size_m // 2
    lat = 379_755_000 + round(north_m / 0.0111)
    return mav.MAVLink_ais_vessel_message(
        211, lat, 237_790_000, 9000, 0, speed_cm_s, 0, 0, 0, half, half, half, half, b"", b"", 0, 0
    )


@pytest.mark.parametrize("speed_cm_s", [0, 300])
def test_a_vehicle_does_not_flee_from_everywhere(speed_cm_s: int) -> None:
    world = PilotedWorld((*PLACE, 0.4, 0.4))
    world.run(1.5)
    world.arm()
    for _ in range(5):
        world.tick([world.pack(ship(136, speed_cm_s=speed_cm_s))])
        world.run(1.99)
    off_m = np.hypot(*(np.array(world.track)[-1000:, :2] - PLACE).T)
    assert off_m.max() < 0.1
    assert world.texts().count("Obstacle of 96 m ignored: it covers the vehicle") == 1


def test_what_is_beside_the_vehicle_is_still_evaded() -> None:
    world = PilotedWorld((*PLACE, 0.4, 0.4))
    world.run(1.5)
    world.arm()
    for _ in range(5):
        # A boat of 8 m whose side comes to 0.2 m from the vehicle's centre.
        world.tick([world.pack(ship(12, north_m=PLACE[0] - 8.67))])
        world.run(1.99)
    assert "ignored" not in world.texts()
    assert world.x[0] > PLACE[0] + 0.05
