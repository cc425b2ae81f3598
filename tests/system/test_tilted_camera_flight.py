"""The marker camera is tilted in flight: the rendered pictures are of another direction, the position stays right."""

import math
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import ArmingSchedule

from autopilot.core.messages import NavHealth, Outputs

TILT = """
[[payload]]
name = "camera tilt"
kind = "tilt"
channel = 20
min_deg = -100.0
max_deg = -40.0
camera_deg = -90.0

[sources]
"""
AWAY_US, BACK_US = 6_000_000, 9_000_000


class Tilter(ArmingSchedule):
    """A client that tilts the camera and back."""

    def __init__(self) -> None:
        super().__init__({}, {1e-6 * AWAY_US: lambda: self._tilt(-75.0), 1e-6 * BACK_US: lambda: self._tilt(-90.0)})

    def _tilt(self, angle_deg: float) -> None:
        params = (angle_deg, math.nan, math.nan, math.nan, 0.0, 0.0, 0.0)
        self.send(mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, 0, *params))


@pytest.mark.parametrize("sensors", ["camera", "pose"])
def test_the_position_stays_right_while_the_camera_looks_elsewhere(
    session: OpenSession, tmp_path: Path, sensors: str
) -> None:
    shipped = (resources.files("autopilot") / "data/vehicles/lbv150.toml").read_text()
    vehicle = tmp_path / "tilting.toml"
    vehicle.write_text(shipped.replace("\n[sources]\n", TILT))
    errors: list[tuple[float, float, NavHealth]] = []
    fixes: list[int] = []
    texts: list[str] = []

    def look(outputs: Outputs) -> None:
        nav, truth = outputs.nav, run.device.truth
        fixes.extend(aid.t_us for aid in outputs.aids if aid.sensor == "markers" and aid.fused)
        texts.extend(event.text for event in outputs.events)
        if nav is not None:
            errors.append((1e-6 * nav.t_us, float(np.abs(nav.pos_ned_m - truth.pos_ned_m).max()), nav.health))

    given = {"vehicle": str(vehicle), "sensors": sensors, "duration": 14.0, "seed": 3, "start": True}
    run = session("paper-tank-still", on_tick=look, peers=(Tilter(),), **given)
    run.run()
    assert "Camera at -75 deg, markers need -90: tilt it" in texts
    assert "Camera is tilted back: markers are used again" in texts
    assert not [t_us for t_us in fixes if AWAY_US + 50_000 < t_us < BACK_US]
    assert max(fixes) > BACK_US + 1_000_000
    assert max(error_m for t_s, error_m, health in errors if t_s > 3.0 and health is not NavHealth.INVALID) < 0.15
    assert {health for t_s, _, health in errors if 7.5 < t_s < 9.0} == {NavHealth.DEAD_RECKONING}
    assert errors[-1][2] is NavHealth.GOOD
