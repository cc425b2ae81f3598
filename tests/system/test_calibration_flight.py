"""``autopilot calibrate flight`` flies its manoeuvre with a simulated vehicle and finds the errors of the scenario."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from system_harness import ROOT

from autopilot.cli.main import cli, run
from autopilot.client.client_session import VehicleConnection
from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import HAND_SIGMA_RAD, RULER_SIGMA_M, STAMP_SIGMA_S, load_vehicle
from autopilot.run.children import Child, autopilot_command, free_port
from autopilot.sitl.camera_sensor import true_camera
from autopilot.sitl.scenario import load_scenario

SCENARIOS = ROOT / "sitl" / "scenarios"
LONGEST_S = 75.0
"""Then the simulation ends, so that the fit has the machine to itself."""
BRISK = ("--param", "SPD_CRUISE=0.5", "--param", "WP_ACCEPT_YAW=1.0")


def dot(camera: CameraModel, depth_m: float) -> FloatArray:
    """x/z and y/z in the camera frame of the laser's dot at a depth along the optical axis."""
    start, along = camera.laser_offset_cam_m, camera.laser_direction_cam
    place: FloatArray = start + along * (depth_m - start[2]) / along[2]
    return place[:2] / depth_m


def test_the_errors_of_the_scenario_are_found(tmp_path: Path) -> None:
    """At half the pictures, which are rendered, and briskly, for the machine's sake."""
    plan, scenario, out = SCENARIOS / "calibration.mission.toml", tmp_path / "half.toml", tmp_path / "new.toml"
    text = (SCENARIOS / "calibration.toml").read_text().replace("calibration.mission.toml", str(plan))
    scenario.write_text(text.replace("stamp_error_s", "rate_hz = 15.0\nstamp_error_s"))
    logs, where = tmp_path / "data", f"127.0.0.1:{free_port()}"
    child = Child(
        autopilot_command(
            *("sitl", str(scenario), "--plan", str(plan), "--speed", "0", "--duration", str(LONGEST_S), *BRISK),
            *("--quiet", "--connect", f"udpin:{where}"),
        ),
        {"AUTOPILOT_STATE_DIR": str(tmp_path / "state"), "XDG_DATA_HOME": str(logs)},
    )
    try:
        with VehicleConnection(f"udpout:{where}", at_work=child.at_work) as session:
            session.connect(60.0)
        arguments = ["calibrate", "flight", "--connect", f"udpout:{where}", "--log", str(logs), "--out", str(out)]
        code = run(lambda: cli([*arguments, "--floor", "1.5", "--laps", "1", "--yes"], standalone_mode=False))
        assert code == 0
    finally:
        assert child.end() == 0
    world, found = load_scenario(str(scenario)), load_vehicle(str(out))
    true = true_camera(CameraModel.of_vehicle(load_vehicle("lbv150")), world.camera, world.sensors.laser)
    camera, eye, laser = CameraModel.of_vehicle(found), found.eye, found.laser
    assert laser is not None
    turned = Rotation.from_matrix(camera.r_frd_from_cam @ true.r_frd_from_cam.T).as_rotvec()
    assert (np.abs(turned) < 3.0 * np.array(eye.mounting_sigma_rad)).all(), turned
    shifted = camera.position_frd_m - true.position_frd_m
    sigma_m = np.array(eye.position_sigma_m)
    seen = sigma_m < RULER_SIGMA_M  # one brisk lap may not show the place
    assert (np.abs(shifted) < 3.0 * sigma_m)[seen].all(), shifted
    late_s = eye.time_offset_s + world.sensors.camera.stamp_error_s
    assert abs(late_s) < 3.0 * eye.time_offset_sigma_s
    for depth_m in (0.6, 0.8, 1.1):
        off = dot(camera, depth_m) - dot(true, depth_m)
        assert (np.abs(off) < 3.0 * laser.direction_sigma_rad).all(), (depth_m, off, laser.direction_sigma_rad)
    assert eye.time_offset_sigma_s < STAMP_SIGMA_S
    assert max(eye.mounting_sigma_rad) < HAND_SIGMA_RAD
    assert laser.direction_sigma_rad < HAND_SIGMA_RAD
    steps = {found.sources[key].split(":")[0] for key in ("camera.time_offset_s", "camera.mounting_rpy_rad")}
    assert steps == {"autopilot calibrate flight, latency", "autopilot calibrate flight, extrinsics"}
