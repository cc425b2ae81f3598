"""What docs/mavsdk_table.py tries of each plugin of MAVSDK."""

import contextlib
import math
import threading
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from mavsdk_bench import EFFECT_S, PATIENCE_S, Bench, Probe, Probes, changing, held, seen, started

ROOT = Path(__file__).resolve().parent.parent
NAN = math.nan
LAT, LON = 37.9755, 23.7790
CAMERA = 100
"""Component id."""


def _stream(plugin: Any, names: str) -> list[tuple[str, Callable[[Callable[..., None]], Any]]]:
    return [(name, getattr(plugin, f"subscribe_{name}")) for name in names.split()]


def _calls(plugin: Any, names: str, *args: Any) -> list[Probe]:
    return [(name, lambda name=name: getattr(plugin, name)(*args)) for name in names.split()]


def _raw_items(kind: int = 0) -> list[Any]:
    item = import_module("mavsdk.plugins.mission_raw").MissionItem
    command, p1 = {0: (16, 0.0), 1: (5004, 0.2), 2: (5100, 0.0)}[kind]
    lats = (379_755_000, 379_755_060)
    return [
        item(n, 3, command, int(n == 0), 1, p1, 0.3, 0.0, NAN, x, 237_790_000, -0.45, kind) for n, x in enumerate(lats)
    ]


def _action(bench: Bench) -> Any:
    a, t, relay = bench.plugin("action"), bench.plugin("telemetry"), import_module("mavsdk.plugins.action").RelayCommand
    here = (LAT, LON, -0.5)

    def disarmed() -> bool:
        return not t.armed()

    def origin() -> bool:
        found = t.get_gps_global_origin()
        return math.hypot(found.latitude_deg - LAT, found.longitude_deg - LON) < 1e-6

    return [
        ("arm_force", seen(a.arm_force, t.armed)),
        ("arm", seen(a.arm, t.armed)),
        ("takeoff", seen(a.takeoff, t.in_air)),
        ("hold", seen(a.hold, bench.in_mode("HOLD"))),
        ("goto_location", seen(lambda: a.goto_location(*here, 0.0), bench.near(0.0, 0.0))),
        ("do_orbit", seen(lambda: a.do_orbit(0.5, 0.1, 0, *here), bench.moves)),
        ("set_current_speed", lambda: a.set_current_speed(0.2)),
        ("return_to_launch", seen(a.return_to_launch, bench.in_mode("RETURN_TO_LAUNCH"))),
        ("reboot while armed", a.reboot),
        ("shutdown while armed", a.shutdown),
        ("land", seen(a.land, bench.in_mode("LAND"))),
        ("(hold)", seen(a.hold, bench.in_mode("HOLD"))),  # else the surface disarms
        ("kill", seen(a.kill, disarmed)),
        ("(arm)", seen(a.arm, t.armed)),
        ("terminate", seen(a.terminate, disarmed)),
        ("(arm)", seen(a.arm, t.armed)),
        ("disarm", seen(a.disarm, disarmed)),
        ("set_takeoff_altitude", lambda: a.set_takeoff_altitude(-0.4)),
        ("get_takeoff_altitude", a.get_takeoff_altitude),
        ("get_return_to_launch_altitude", a.get_return_to_launch_altitude),
        ("set_gps_global_origin", seen(lambda: a.set_gps_global_origin(LAT, LON, 0.0), origin)),
        ("set_actuator", changing(lambda: a.set_actuator(1, 0.0), bench.outputs)),
        ("set_relay", changing(lambda: a.set_relay(0, relay.ON), bench.outputs)),
        *_calls(a, "transition_to_fixedwing transition_to_multicopter"),
    ], []


def _calibration(bench: Bench) -> Any:
    c = bench.plugin("calibration")
    kinds = "gyro accelerometer magnetometer level_horizon gimbal_accelerometer"
    return [
        *((kind, started(getattr(c, f"calibrate_{kind}_async"))) for kind in kinds.split()),
        ("cancel", c.cancel),
    ], []


def _camera(bench: Bench) -> Any:
    c, m = bench.plugin("camera"), import_module("mavsdk.plugins.camera")
    photos: list[Any] = []
    c.subscribe_capture_info(lambda info, _: photos.append(info))

    def taken() -> int:
        return len(photos)

    return [
        ("camera_list", seen(c.camera_list, lambda: bool(c.camera_list().cameras))),
        ("set_mode", seen(lambda: c.set_mode(CAMERA, m.Mode.PHOTO), lambda: c.get_mode(CAMERA).name == "PHOTO")),
        ("take_photo", changing(lambda: c.take_photo(CAMERA), taken)),
        ("start_photo_interval", seen(lambda: c.start_photo_interval(CAMERA, 1.0), lambda: taken() > 2)),
        ("stop_photo_interval", lambda: c.stop_photo_interval(CAMERA)),
        ("get_storage", lambda: c.get_storage(CAMERA)),
        ("start_video", lambda: c.start_video(CAMERA)),
        ("stop_video", lambda: c.stop_video(CAMERA)),
        ("zoom_in_start", lambda: c.zoom_in_start(CAMERA)),
        ("focus_in_start", lambda: c.focus_in_start(CAMERA)),
        ("format_storage", lambda: c.format_storage(CAMERA, 1)),
    ], _stream(c, "camera_list mode storage")


def _metadata(bench: Bench) -> Any:
    c = bench.plugin("component_metadata")

    def read() -> Any:
        there = threading.Event()
        c.subscribe_metadata_available(lambda update, _: there.set())
        c.request_autopilot_component()
        if not there.wait(PATIENCE_S - 2.0):
            raise TimeoutError("no metadata")
        return len(
            c.get_metadata(1, import_module("mavsdk.plugins.component_metadata").MetadataType.PARAMETER).json_metadata
        )

    return [("parameters", read)], []


def _events(bench: Bench) -> Any:
    e = bench.plugin("events")
    arm = bench.plugin("action")

    def stir(told: Callable[..., None]) -> None:
        e.subscribe_events(told)
        with contextlib.suppress(Exception):
            arm.arm()
        with contextlib.suppress(Exception):
            arm.disarm()

    there = threading.Event()

    def report() -> Any:
        """It comes once the metadata have been read."""
        e.subscribe_health_and_arming_checks(lambda *_: there.set())
        there.wait(EFFECT_S)
        return e.get_health_and_arming_checks_report()

    return [("get_health_and_arming_checks_report", report)], [
        *_stream(e, "health_and_arming_checks"),
        ("events", stir),
    ]


def _failure(bench: Bench) -> Any:
    f, m = bench.plugin("failure"), import_module("mavsdk.plugins.failure")
    return [("inject", lambda: f.inject(m.FailureUnit.SENSOR_GYRO, m.FailureType.OFF, 0))], []


def _follow(bench: Bench) -> Any:
    f = bench.plugin("follow_me")
    return [("set_config", lambda: f.set_config(f.get_config())), ("start", f.start), ("stop", f.stop)], []


def _ftp(bench: Bench) -> Any:
    f, target = bench.plugin("ftp"), str(bench.folder)
    name, other = "parameters.json.xz", "general.json.xz"
    own = bench.folder / "own.txt"
    own.write_text("own")

    def whole(name: str) -> Callable[[], bool]:
        return lambda: (bench.folder / name).stat().st_size > 0

    return [
        ("list_directory", lambda: f.list_directory("/")),
        ("download", seen(started(lambda told: f.download_async(name, target, False, told)), whole(name))),
        ("download by bursts", seen(started(lambda told: f.download_async(other, target, True, told)), whole(other))),
        ("are_files_identical", lambda: f.are_files_identical(str(bench.folder / name), name)),
        ("upload", started(lambda told: f.upload_async(str(own), "/", told))),
        ("create_directory", lambda: f.create_directory("x")),
        ("remove_file", lambda: f.remove_file(name)),
        ("rename", lambda: f.rename(name, "y")),
    ], []


def _geofence(bench: Bench) -> Any:
    g, m = bench.plugin("geofence"), import_module("mavsdk.plugins.geofence")
    corners = [m.Point(LAT + dx * 1e-5, LON + dy * 1e-5) for dx, dy in ((-2, -2), (-2, 2), (2, 2), (2, -2))]
    data = m.GeofenceData([m.Polygon(corners, m.FenceType.INCLUSION)], [])

    def stands() -> bool:
        return held(lambda: g.download_geofence().polygons)

    return [
        ("upload_geofence", seen(lambda: g.upload_geofence(data), stands)),
        ("download_geofence", g.download_geofence),
        ("clear_geofence", seen(g.clear_geofence, lambda: not stands())),
    ], []


def _gimbal(bench: Bench) -> Any:
    g, m = bench.plugin("gimbal"), import_module("mavsdk.plugins.gimbal")
    return [
        ("gimbal_list", g.gimbal_list),
        ("take_control", lambda: g.take_control(1, m.ControlMode.PRIMARY)),
        ("set_angles", lambda: g.set_angles(1, 0.0, -30.0, 0.0, m.GimbalMode(0), m.SendMode(0))),
    ], _stream(g, "gimbal_list")


def _gripper(bench: Bench) -> Any:
    g = bench.plugin("gripper")
    return [
        ("(release)", lambda: g.release(1)),
        ("grab", changing(lambda: g.grab(1), bench.outputs)),
        ("release", changing(lambda: g.release(1), bench.outputs)),
    ], []


def _info(bench: Bench) -> Any:
    i = bench.plugin("info")
    return _calls(i, "get_identification get_product get_version get_speed_factor"), _stream(i, "flight_information")


def _logs(bench: Bench) -> Any:
    f = bench.plugin("log_files")
    file = bench.folder / "flight.mcap"

    def load(told: Callable[..., None]) -> None:
        f.download_log_file_async(f.get_entries()[0], str(file), told)

    return [
        ("get_entries", f.get_entries),
        ("download_log_file", seen(started(load), lambda: file.stat().st_size > 0)),
        ("erase_all", seen(f.erase_all_log_files, lambda: len(f.get_entries()) == 1)),
    ], []


def _manual(bench: Bench) -> Any:
    m, action = bench.plugin("manual_control"), bench.plugin("action")

    def sticks(start: Callable[[], Any]) -> Callable[[], Any]:
        def run() -> Any:
            action.arm()
            for _ in range(40):
                m.set_manual_control_input(0.0, 0.0, 0.5, 0.0)
                time.sleep(0.05)
            return start()

        return run

    modes = {"start_altitude_control": "ALTCTL", "start_position_control": "POSCTL"}
    starts = ((name, seen(sticks(getattr(m, name)), bench.in_mode(mode))) for name, mode in modes.items())
    return [*starts, ("(disarm)", action.disarm)], []


def _direct(bench: Bench) -> Any:
    m, d = import_module("mavsdk.plugins.mavlink_direct"), bench.plugin("mavlink_direct")
    ping = m.MavlinkMessage("PING", 245, 190, 0, 0, '{"time_usec":1,"seq":1,"target_system":0,"target_component":0}')
    return [("send_message", lambda: d.send_message(ping))], [
        ("message", lambda told: d.subscribe_message("HEARTBEAT", told)),
    ]


def _mission(bench: Bench) -> Any:
    p, raw, m = bench.plugin("mission"), bench.plugin("mission_raw"), import_module("mavsdk.plugins.mission")
    items = [
        m.MissionItem(LAT + n * 6e-6, LON, -0.45, 0.3, n > 0, NAN, NAN, m.MissionItem.CameraAction.NONE)
        for n in range(2)
    ]
    action = bench.plugin("action")
    return [
        (
            "upload_mission",
            seen(
                lambda: p.upload_mission(m.MissionPlan(items)),
                lambda: len(p.download_mission().mission_items) == len(items),
            ),
        ),
        ("download_mission", p.download_mission),
        ("(arm)", action.arm),
        ("start_mission", seen(p.start_mission, bench.in_mode("MISSION"))),
        ("pause_mission", seen(p.pause_mission, bench.in_mode("HOLD"))),
        (
            "set_current_mission_item",
            seen(lambda: p.set_current_mission_item(1), lambda: p.mission_progress().current == 1),
        ),
        ("is_mission_finished", p.is_mission_finished),
        ("(disarm)", action.disarm),
        ("clear_mission", seen(p.clear_mission, lambda: not held(raw.download_mission))),
    ], _stream(p, "mission_progress")


def _mission_raw(bench: Bench) -> Any:
    p, action = bench.plugin("mission_raw"), bench.plugin("action")
    return [
        ("upload_mission", lambda: p.upload_mission(_raw_items())),
        ("upload_geofence", lambda: p.upload_geofence([])),
        ("upload_rally_points", lambda: p.upload_rally_points(_raw_items(2))),
        *_calls(p, "download_mission download_geofence download_rallypoints"),
        ("(arm)", action.arm),
        ("start_mission", seen(p.start_mission, bench.in_mode("MISSION"))),
        ("pause_mission", seen(p.pause_mission, bench.in_mode("HOLD"))),
        (
            "set_current_mission_item",
            seen(lambda: p.set_current_mission_item(1), lambda: p.mission_progress().current == 1),
        ),
        ("(disarm)", action.disarm),
        ("clear_mission", seen(p.clear_mission, lambda: not held(p.download_mission))),
        (
            "import_qgroundcontrol_mission",
            lambda: p.import_qgroundcontrol_mission(str(ROOT / "sitl/scenarios/paper.plan")),
        ),
    ], _stream(p, "mission_progress")


def _mocap(bench: Bench) -> Any:
    p, m = bench.plugin("mocap"), import_module("mavsdk.plugins.mocap")
    pose = m.VisionPositionEstimate(0, m.PositionBody(0.0, 0.0, 0.5), m.AngleBody(0.0, 0.0, 0.0), m.Covariance([NAN]))
    return [("set_vision_position_estimate", lambda: p.set_vision_position_estimate(pose))], []


def _offboard(bench: Bench) -> Any:
    o, m, action = bench.plugin("offboard"), import_module("mavsdk.plugins.offboard"), bench.plugin("action")
    t = bench.plugin("telemetry")

    def speed_m_s(toward_deg: float) -> float:
        speed, toward = t.velocity_ned(), math.radians(toward_deg)
        return float(speed.north_m_s) * math.cos(toward) + float(speed.east_m_s) * math.sin(toward)

    def heading_deg() -> float:
        return float(t.attitude_euler().yaw_deg)

    def backs_and_turns() -> bool:
        return speed_m_s(heading_deg()) < -0.05 and t.attitude_angular_velocity_body().yaw_rad_s > 0.1

    return [
        ("(arm)", action.arm),
        ("(set_velocity_ned)", lambda: o.set_velocity_ned(m.VelocityNedYaw(0.0, 0.0, 0.0, 0.0))),
        ("start", seen(o.start, bench.in_mode("OFFBOARD"))),
        (
            "set_position_ned",
            seen(lambda: o.set_position_ned(m.PositionNedYaw(0.0, 0.5, 0.5, 0.0)), bench.near(0.0, 0.5)),
        ),
        (
            "set_velocity_ned",
            seen(lambda: o.set_velocity_ned(m.VelocityNedYaw(0.1, 0.0, 0.0, 0.0)), lambda: speed_m_s(0.0) > 0.05),
        ),
        (
            "set_velocity_body",
            seen(lambda: o.set_velocity_body(m.VelocityBodyYawspeed(-0.1, 0.0, 0.0, 10.0)), backs_and_turns),
        ),
        (
            "set_attitude",
            seen(lambda: o.set_attitude(m.Attitude(0.0, 0.0, -90.0, 0.5)), lambda: abs(heading_deg() + 90.0) < 5.0),
        ),
        ("stop", seen(o.stop, bench.in_mode("HOLD"))),
        ("(disarm)", action.disarm),
    ], []


def _param(bench: Bench) -> Any:
    p = bench.plugin("param")
    return [
        ("get_all_params", p.get_all_params),
        ("get_param_float", lambda: p.get_param_float("SPD_CRUISE")),
        (
            "set_param_float",
            seen(
                lambda: p.set_param_float("SPD_CRUISE", 0.3), lambda: abs(p.get_param_float("SPD_CRUISE") - 0.3) < 1e-6
            ),
        ),
        ("get_param_int", lambda: p.get_param_int("FS_SOLVER_N")),
        ("set_param_int", lambda: p.set_param_int("FS_SOLVER_N", 40)),
        ("a value out of range", lambda: p.set_param_float("SPD_CRUISE", 50.0)),
        ("get_param_custom", lambda: p.get_param_custom("X")),
    ], []


def _telemetry(bench: Bench) -> Any:
    t = bench.plugin("telemetry")
    names = sorted(name.removeprefix("subscribe_") for name in dir(t) if name.startswith("subscribe_"))
    return [
        ("get_gps_global_origin", t.get_gps_global_origin),
        ("set_rate_position", lambda: t.set_rate_position(4.0)),
        ("set_rate_gps_info", lambda: t.set_rate_gps_info(1.0)),
        ("set_rate_ground_truth", lambda: t.set_rate_ground_truth(1.0)),
    ], _stream(t, " ".join(name for name in names if name != "status_text"))


def _tune(bench: Bench) -> Any:
    t, m = bench.plugin("tune"), import_module("mavsdk.plugins.tune")
    return [("play_tune", lambda: t.play_tune(m.TuneDescription([m.SongElement.NOTE_A], 100)))], []


def _winch(bench: Bench) -> Any:
    w = bench.plugin("winch")
    return _calls(w, "hold relax", 1), _stream(w, "status")


PROBES: dict[str, Probes] = {
    "action": _action,
    "calibration": _calibration,
    "camera": _camera,
    "component_metadata": _metadata,
    "events": _events,
    "failure": _failure,
    "follow_me": _follow,
    "ftp": _ftp,
    "geofence": _geofence,
    "gimbal": _gimbal,
    "gripper": _gripper,
    "info": _info,
    "log_files": _logs,
    "log_streaming": lambda b: (_calls(b.plugin("log_streaming"), "start_log_streaming"), []),
    "manual_control": _manual,
    "mavlink_direct": _direct,
    "mission": _mission,
    "mission_raw": _mission_raw,
    "mocap": _mocap,
    "offboard": _offboard,
    "param": _param,
    "rtk": lambda b: (
        [
            (
                "send_rtcm_data",
                lambda: b.plugin("rtk").send_rtcm_data(import_module("mavsdk.plugins.rtk").RtcmData("AAAA")),
            )
        ],
        [],
    ),
    "shell": lambda b: (
        [("send", lambda: b.plugin("shell").send("help\n", import_module("mavsdk.plugins.shell").Device(10)))],
        _stream(b.plugin("shell"), "receive"),
    ),
    "telemetry": _telemetry,
    "transponder": lambda b: ([], _stream(b.plugin("transponder"), "transponder")),
    "tune": _tune,
    "winch": _winch,
}
"""What is tried of each plugin: calls, and streams that are listened to."""
