"""CDR bytes against rosbags, an implementation of ROS 2 serialisation that is not ours."""

import math
import struct
from enum import Enum
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_synthetic import Truth
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.marks import LoopPart
from autopilot.core.messages import (
    AidState,
    AidStatus,
    Event,
    Fallback,
    Goal,
    Inputs,
    LoopStats,
    MarkerFit,
    MissionProgress,
    ModeState,
    NavCounters,
    NavDoubt,
    NavHealth,
    NavState,
    NmpcStatus,
    ProcessStats,
    ProgressState,
    ShadowStatus,
    SolveStatus,
    ThrusterCommand,
)
from autopilot.core.samples import (
    AhrsSample,
    LaserSample,
    MarkerSighting,
    PowerSample,
)
from autopilot.core.sensors import AID_SENSORS
from autopilot.log import topics, visuals
from autopilot.log.cdr import ENCAPSULATION, CdrBuffer, decode, fixed_layout, parse_definition
from autopilot.log.packing import sensor_records
from autopilot.log.packing.records import pack_record
from autopilot.log.sample_table import SAMPLE_ROWS, SampleRow
from autopilot.log.schemas import definition, layout, ros_name, type_names, types_of
from autopilot.replay.inputs import SAMPLES
from tests.sample_kinds import sample_of

STORE = get_typestore(Stores.LATEST)
for _name in type_names():
    if _name.startswith("autopilot_msgs/"):
        _own = definition(_name).split("=" * 80)[0]
        STORE.register(get_types_from_msg(_own, ros_name(_name)))

floats = st.floats(allow_nan=False, width=64)
finite = st.floats(min_value=-1e6, max_value=1e6)
stamps = st.integers(min_value=0, max_value=2**31 * 10**9 - 1)
u8, u16, u32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))


def vec(n: int) -> st.SearchStrategy[Any]:
    return st.lists(floats, min_size=n, max_size=n).map(np.array)


def read_back(name: str, data: bytes) -> Any:
    """The message as rosbags reads it; serialising it again must give the same bytes."""
    message = STORE.deserialize_cdr(data, ros_name(name))
    assert bytes(STORE.serialize_cdr(message, ros_name(name))) == data
    return message


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


@pytest.mark.parametrize("name", [n for n in type_names() if not n.startswith(("autopilot_msgs/", "foxglove_msgs/"))])
def test_standard_types_have_the_fields_of_ros(name: str) -> None:
    reference, _ = STORE.generate_msgdef(ros_name(name), ros_version=2)
    assert types_of(name) == parse_definition(name, reference)


@pytest.mark.parametrize("name", type_names())
def test_schema_text_is_closed_and_understood_by_rosbags(name: str) -> None:
    parts = definition(name).split("=" * 80 + "\n")
    for part in parts[1:]:
        assert part.startswith("MSG: ")
    used = {field.type for fields in types_of(name).values() for field in fields}
    defined = {part.splitlines()[0].removeprefix("MSG: ") for part in parts[1:]}
    assert {u for u in used if "/" in u} <= defined
    assert get_types_from_msg(parts[0], ros_name(name))


@pytest.mark.parametrize("name", [n for n in type_names() if n.startswith(("autopilot_msgs/", "sensor_msgs/Imu"))])
def test_layout_agrees_with_decoder(name: str) -> None:
    """Random bytes in every field: numpy view and generic decoder see the same values."""
    fixed = layout(name)
    raw = bytearray(np.random.default_rng(1).integers(0, 64, fixed.packer.size, dtype=np.uint8).tobytes())
    raw[:4] = ENCAPSULATION
    raw[12:20] = struct.pack("<I4s", 4, b"ned\0")
    value = decode(types_of(name), name, bytes(raw))
    row = np.frombuffer(bytes(raw), fixed.dtype)[0]
    assert fixed.dtype.names is not None
    for field in fixed.dtype.names[1:]:
        seen, expected = row[field], value[field]
        if isinstance(expected, dict):
            assert list(seen.tolist()) == list(expected.values())
        elif isinstance(expected, bytes):
            assert seen.tobytes() == expected
        else:
            np.testing.assert_array_equal(seen, expected)


@given(stamps, vec(3), vec(3), vec(3), vec(3), vec(3), vec(3), vec(12), u8, u32)
@settings(max_examples=25, deadline=None)
def test_nav(stamp: int, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, var: Any, health: int, resets: int) -> None:
    nav = NavState(
        t_us=0,
        health=NavHealth(health % 3),
        pos_ned_m=a,
        rpy_rad=b,
        vel_frd_m_s=c,
        vel_water_frd_m_s=d,
        rate_frd_rad_s=e,
        current_ned_m_s=f,
        variance=var,
        reset_count=resets,
        doubts=frozenset(doubt for bit, doubt in enumerate(NavDoubt) if resets >> bit & 1),
    )
    state = read_back("autopilot_msgs/VehicleState", pack_record("/nav/state", stamp, nav))
    assert stamp_of(state.header) == stamp and state.header.frame_id == "ned"
    for field in ("pos_ned_m", "rpy_rad", "vel_frd_m_s", "vel_water_frd_m_s", "rate_frd_rad_s", "current_ned_m_s"):
        np.testing.assert_array_equal(getattr(state, field), getattr(nav, field))
    covariance = read_back("autopilot_msgs/NavCovariance", pack_record("/nav/covariance", stamp, nav))
    np.testing.assert_array_equal(covariance.variance, var)
    status = read_back("autopilot_msgs/NavStatus", pack_record("/nav/status", stamp, nav))
    assert (status.health, status.reset_count) == (health % 3, resets)
    assert status.doubts == resets % (1 << len(NavDoubt))


@given(stamps, st.lists(floats, min_size=1, max_size=8), finite, u32, finite)
@settings(max_examples=25, deadline=None)
def test_truth_thrusters_and_contact(stamp: int, thrust: list[float], power: float, count: int, depth: float) -> None:
    zero = np.zeros(3)
    truth = Truth(
        pos_ned_m=zero,
        rpy_rad=zero,
        vel_frd_m_s=zero,
        vel_water_frd_m_s=zero,
        rate_frd_rad_s=zero,
        current_ned_m_s=zero,
        thrust_n=np.array(thrust),
        power_w=power,
    )
    state = read_back("autopilot_msgs/ThrusterState", pack_record("/sim/thrusters", stamp, truth))
    np.testing.assert_array_equal(state.thrust_n, thrust + [0.0] * (8 - len(thrust)))
    assert state.power_w == power
    contact = read_back("autopilot_msgs/ContactState", pack_record("/sim/contact", stamp, (count, depth)))
    assert (contact.count, contact.penetration_m) == (count, depth)


@given(stamps, vec(3), st.none() | finite, finite, finite, finite, st.integers(-(2**31), 2**31 - 1))
@settings(max_examples=25, deadline=None)
def test_goal(stamp: int, pos: Any, yaw: float | None, speed: float, radius: float, band: float, seq: int) -> None:
    goal = Goal(pos_ned_m=pos, yaw_rad=yaw, speed_m_s=speed, accept_radius_m=radius, accept_yaw_rad=band, seq=seq)
    read = read_back("autopilot_msgs/Goal", pack_record("/ctl/goal", stamp, goal))
    np.testing.assert_array_equal(read.pos_ned_m, pos)
    assert (read.yaw_free, read.yaw_rad) == ((1, 0.0) if yaw is None else (0, yaw))
    assert (read.speed_m_s, read.accept_radius_m, read.accept_yaw_rad, read.seq) == (speed, radius, band, seq)


@given(stamps, vec(8), st.lists(u16, min_size=0, max_size=8), u16, finite, finite, st.booleans(), u32, u32)
@settings(max_examples=25, deadline=None)
def test_control_and_system(
    stamp: int,
    thrust: Any,
    pwm: list[int],
    count: int,
    x: float,
    y: float,
    flag: bool,
    a: int,
    b: int,
) -> None:
    command = pack_record("/out/thrusters", stamp, ThrusterCommand(t_us=0, thrust_n=thrust, pwm_us=tuple(pwm)))
    read = read_back("autopilot_msgs/ThrusterCommand", command)
    np.testing.assert_array_equal(read.thrust_n, thrust)
    assert read.pwm_us.tolist() == pwm + [0] * (8 - len(pwm))
    nmpc = NmpcStatus(
        t_us=0,
        status=SolveStatus.RESIDUAL,
        fallback=Fallback.SHIFTED_PLAN,
        iterations=count,
        solve_s=x,
        cost=y,
        slack_max=x,
        margin_m=y,
        tube_m=x,
        penalty_use=y,
    )
    read = read_back("autopilot_msgs/NmpcStatus", pack_record("/ctl/nmpc", stamp, nmpc))
    assert (read.status, read.fallback, read.iterations, read.solve_s, read.cost) == (3, 1, count, x, y)
    assert (read.slack_max, read.margin_m, read.tube_m, read.penalty_use) == (x, y, x, y)
    progress = MissionProgress(t_us=0, current_seq=-1, reached_seq=3, lap=count, state=ProgressState.ACTIVE)
    read = read_back("autopilot_msgs/MissionProgress", pack_record("/mission/progress", stamp, progress))
    assert (read.current_seq, read.reached_seq, read.lap, read.state) == (-1, 3, count, 3)
    mode = ModeState(t_us=0, armed=flag, custom_mode=a, failsafes=b)
    read = read_back("autopilot_msgs/ModeState", pack_record("/sys/mode", stamp, mode))
    assert (read.armed, read.custom_mode, read.failsafes) == (flag, a, b)
    parts = tuple(x if part == LoopPart.RECORD else 0.0 for part in LoopPart)
    stats = LoopStats(t_us=0, tick_s=x, cpu_s=y, overruns=a, dropped_log=b, dropped_frames=b, part_s=parts)
    read = read_back("autopilot_msgs/LoopStats", pack_record("/sys/loop", stamp, stats))
    assert (read.tick_s, read.cpu_s, read.overruns, read.dropped_log, read.dropped_frames) == (x, y, a, b, b)
    assert read.late_part == int(stats.late_part) and tuple(read.part_s) == parts
    process = ProcessStats(rss_bytes=a, log_queue=b, log_queue_bytes=a, threads=count, collect_s=x)
    read = read_back("autopilot_msgs/ProcessStats", pack_record("/sys/process", stamp, process))
    assert (read.rss, read.log_queue, read.log_queue_bytes, read.threads, read.collect_s) == (a, b, a, count, x)
    fit = MarkerFit(known=count, used=3, rms_px=x, worst_px=y)
    read = read_back("autopilot_msgs/MarkerFit", pack_record("/nav/fit", stamp, fit))
    assert (read.known, read.used, read.rms_px, read.worst_px) == (count, 3, x, y)
    inputs = Inputs(t_us=0, overruns=a, cpu_load=x)
    read = read_back("autopilot_msgs/InputTick", pack_record("/in/tick", stamp, inputs))
    assert (read.samples, read.frames, read.overruns, read.cpu_load) == (0, 0, a, x)
    aid = AidStatus(
        t_us=0,
        sensor="markers",
        innovation=thrust[:3],
        innovation_var=thrust[3:6],
        test_ratio=x,
        fused=flag,
        state=AidState.REJECTING,
        age_s=y,
    )
    read = read_back("autopilot_msgs/AidStatus", pack_record("/nav/aid/markers", stamp, aid))
    np.testing.assert_array_equal(read.innovation, thrust[:3])
    np.testing.assert_array_equal(read.innovation_var, thrust[3:6])
    assert (read.test_ratio, read.fused, read.state, read.age_s) == (x, flag, 3, y)


@given(stamps, st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3), vec(3), finite, finite)
@settings(max_examples=25, deadline=None)
def test_what_viewers_get_of_samples(stamp: int, rpy: list[float], v: Any, x: float, y: float) -> None:
    ahrs = AhrsSample(t_us=0, rpy_rad=np.array(rpy), rate_frd_rad_s=v, accel_frd_m_s2=-v)
    imu = read_back("sensor_msgs/Imu", sensor_records.imu(stamp, ahrs))
    q = imu.orientation
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    assert yaw == pytest.approx(rpy[2], abs=1e-9)
    assert (imu.linear_acceleration.x, imu.linear_acceleration.z) == (-v[0], -v[2])
    laser = LaserSample(t_us=0, range_m=x, sigma_m=y)
    assert read_back("sensor_msgs/Range", sensor_records.laser_range(stamp, laser)).range == np.float32(x)
    power = PowerSample(t_us=0, voltage_v=x, current_a=y, energy_used_j=x, remaining=0.5)
    battery = STORE.deserialize_cdr(visuals.battery_state(stamp, power), "sensor_msgs/msg/BatteryState")
    assert (battery.voltage, battery.current, battery.percentage) == (np.float32(x), np.float32(-y), 0.5)
    assert battery.present and math.isnan(battery.temperature)


@pytest.mark.parametrize("row", [row for row in SAMPLE_ROWS if row.of is not MarkerSighting], ids=lambda row: row.type)
@given(stamp=stamps, data=st.data())
@settings(max_examples=25, deadline=None)
def test_a_sample_of_any_kind_comes_back(row: SampleRow, stamp: int, data: st.DataObject) -> None:
    """As another decoder understands the message, and as a replay reads it."""
    sample = data.draw(samples_of(row))
    message = pack_record(row.topic, stamp, sample)
    read = read_back(f"autopilot_msgs/{row.type}", message)
    for name in read.__dataclass_fields__.keys() & row.of.__dataclass_fields__.keys():
        meant = getattr(sample, name)
        missing = np.zeros(16) if name in row.known.values() else np.nan
        np.testing.assert_array_equal(
            np.ravel(getattr(read, name)),
            np.ravel(np.resize(missing, np.size(getattr(read, name))) if meant is None else meant),
        )
    raw = np.frombuffer(message, layout(f"autopilot_msgs/{row.type}").dtype, offset=0)[0]
    again = SAMPLES[row.topic]({"t_us": sample.t_us, **{name: raw[name] for name in raw.dtype.names}})
    for name in row.of.__dataclass_fields__:
        np.testing.assert_equal(getattr(again, name), getattr(sample, name))


class AnyValue:
    """See :class:`tests.sample_kinds.Draw`."""

    def __init__(self, draw: st.DrawFn) -> None:
        self._draw = draw

    def missing(self) -> bool:
        return self._draw(st.booleans())

    def scalar(self, name: str, kind: type) -> Any:
        return self._draw({int: u32, float: finite, bool: st.booleans()}[kind])

    def member(self, kind: type[Enum]) -> Enum:
        return self._draw(st.sampled_from(kind))

    def array(self, name: str, size: int) -> FloatArray:
        values: FloatArray = self._draw(vec(size))
        return values


@st.composite
def samples_of(draw: st.DrawFn, row: SampleRow) -> Any:
    """Any sample of one kind."""
    return sample_of(row, draw(st.integers(0, 2**62)), AnyValue(draw))


@given(stamps, vec(3), finite, finite, u32, st.booleans())
@settings(max_examples=25, deadline=None)
def test_estimator_watch(stamp: int, v: Any, x: float, y: float, count: int, flag: bool) -> None:
    counts = {"ahrs.stuck": count, "depth.rejected": count, "laser.resets": 2, "unknown": 9}
    counters = NavCounters(t_us=0, counts=counts)
    read = read_back("autopilot_msgs/NavCounters", pack_record("/nav/counters", stamp, counters))
    assert (read.ahrs_stuck, read.rejected[AID_SENSORS.index("depth")], read.aid_resets[6]) == (count, count, 2)
    assert read.ahrs_good == read.received.sum() == 0
    shadow = ShadowStatus(
        t_us=0,
        pos_difference_ned_m=v,
        yaw_difference_rad=x,
        vel_difference_frd_m_s=-v,
        ratio=y,
        disagrees=flag,
    )
    read = read_back("autopilot_msgs/ShadowStatus", pack_record("/nav/shadow", stamp, shadow))
    np.testing.assert_array_equal(read.pos_difference_ned_m, v)
    assert (read.yaw_difference_rad, read.ratio, read.disagrees) == (x, y, flag)


@given(stamps, st.integers(0, 80), st.booleans(), u32)
@settings(max_examples=25, deadline=None)
def test_marker_sighting(stamp: int, count: int, laser: bool, decode_us: int) -> None:
    corners = np.random.default_rng(count).normal(300.0, 50.0, (count, 4, 2)).astype(np.float32)
    sighting = MarkerSighting(
        t_us=0,
        ids=tuple(range(count)),
        corners_px=corners,
        laser_px=np.array([1.5, 2.5]) if laser else None,
        sigma_px=np.full(count, 0.25) if laser else None,
        decode_us=decode_us,
    )
    read = read_back("autopilot_msgs/MarkerSighting", sensor_records.marker_sighting(stamp, sighting))
    kept = min(count, sensor_records.MAX_MARKERS)
    assert (read.count, read.laser_found, read.decode_us) == (kept, int(laser), decode_us)
    assert read.ids[:kept].tolist() == list(range(kept)) and not read.ids[kept:].any()
    np.testing.assert_array_equal(read.corners_px[: 8 * kept], corners[:kept].ravel())
    assert read.laser_px.tolist() == ([1.5, 2.5] if laser else [0.0, 0.0])
    assert read.sigma_px.tolist() == [0.25 if laser else 0.0] * kept + [0.0] * (sensor_records.MAX_MARKERS - kept)
    assert read.header.frame_id == "cam"


@given(stamps, st.binary(min_size=0, max_size=280), st.integers(-1, 20), st.integers(0, 0xFFFF))
@settings(max_examples=25, deadline=None)
def test_mavlink_frame(stamp: int, data: bytes, link: int, client: int) -> None:
    read = read_back("autopilot_msgs/MavlinkFrame", pack_record("/in/mavlink", stamp, (data, link, client)))
    assert read.data.tobytes()[: read.length] == data
    assert read.link == (255 if link < 0 else link)
    assert read.client == client


@given(stamps, st.lists(st.tuples(finite, finite, finite), max_size=5), st.text(max_size=40), st.binary(max_size=50))
@settings(max_examples=25, deadline=None)
def test_variable_types(stamp: int, points: list[tuple[float, float, float]], text: str, blob: bytes) -> None:
    path = read_back("nav_msgs/Path", visuals.path(stamp, points))
    assert [(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in path.poses] == points
    log = read_back("rcl_interfaces/Log", visuals.event(stamp, Event(t_us=0, severity=4, text=text)))
    assert (log.level, log.msg, log.name) == (30, text.replace("\0", " "), "autopilot")
    image = read_back("sensor_msgs/CompressedImage", visuals.compressed_image(stamp, blob))
    assert (image.format, image.data.tobytes()) == ("jpeg", blob)
    marker = visuals.VisualMarker(
        namespace="tank",
        number=3,
        kind=visuals.VisualMarker.LINE_STRIP,
        points_ned_m=tuple(points),
        color_rgba=(1, 0, 0, 1),
    )
    array = read_back("visualization_msgs/MarkerArray", visuals.marker_array(stamp, [marker, marker]))
    assert [(p.x, p.y, p.z) for p in array.markers[1].points] == points
    assert (array.markers[0].ns, array.markers[0].id, array.markers[0].type) == ("tank", 3, 4)
    assert array.markers[1].pose.orientation.w == 1.0
    assert (
        decode(types_of("nav_msgs/Path"), "nav_msgs/Path", visuals.path(stamp, points))["header"]["frame_id"] == "ned"
    )


def test_pose_and_transforms() -> None:
    zero = np.zeros(3)
    nav = NavState(
        t_us=0,
        health=NavHealth.GOOD,
        pos_ned_m=np.array([1.0, 2.0, 3.0]),
        rpy_rad=np.array([0.0, 0.0, math.pi / 2]),
        vel_frd_m_s=zero,
        vel_water_frd_m_s=zero,
        rate_frd_rad_s=zero,
        current_ned_m_s=zero,
        variance=np.zeros(12),
    )
    pose = read_back("geometry_msgs/PoseStamped", visuals.pose_stamped(5, nav))
    assert (pose.pose.position.y, pose.pose.orientation.z) == (2.0, pytest.approx(math.sqrt(0.5)))
    tf = read_back("tf2_msgs/TFMessage", visuals.transforms(5, nav))
    assert [(t.header.frame_id, t.child_frame_id) for t in tf.transforms] == [("map", "ned"), ("ned", "frd")]
    assert tf.transforms[1].transform.translation.z == 3.0
    assert tf.transforms[0].transform.rotation.x == 1.0


@given(
    st.sampled_from(["nav_msgs/Path", "rcl_interfaces/Log", "autopilot_msgs/Goal", "sensor_msgs/BatteryState"]),
    st.binary(),
)
@settings(max_examples=100, deadline=None)
def test_decoder_survives_anything(name: str, data: bytes) -> None:
    for raw in (data, ENCAPSULATION + data):
        try:
            decode(types_of(name), name, raw)
        except LogError as error:
            assert name in str(error)


def test_decoder_names_the_type_of_a_short_message() -> None:
    data = pack_record("/sim/contact", 0, (1, 0.0))
    for length in range(len(data)):
        with pytest.raises(LogError, match="ContactState"):
            decode(types_of("autopilot_msgs/ContactState"), "autopilot_msgs/ContactState", data[:length])


def test_definitions_of_others() -> None:
    text = (
        "# c\nHeader header\nint32 LIMIT=5\nint32 x 3\nuint8[<=4] few\nstring<=10 name\nPoint[2] ends\nfloat32[] v\n"
        "===\nMSG: a/msg/Point\nfloat64 x\n===\nMSG: std_msgs/Header\nstring frame_id"
    )
    types = parse_definition("a/msg/B", text)
    assert [(f.name, f.type, f.count) for f in types["a/B"]] == [
        ("header", "std_msgs/Header", None),
        ("x", "int32", None),
        ("few", "uint8", -1),
        ("name", "string", None),
        ("ends", "a/Point", 2),
        ("v", "float32", -1),
    ]
    assert fixed_layout(types, "a/B", 4) is None
    for bad in ("float64", "Missing x"):
        with pytest.raises(LogError, match="schema"):
            parse_definition("a/B", bad)


def test_unknown_types_and_topics_are_named() -> None:
    with pytest.raises(LogError, match="no_msgs/Thing"):
        definition("no_msgs/Thing")
    with pytest.raises(LogError, match="nav_msgs/Path"):
        layout("nav_msgs/Path")
    with pytest.raises(LogError, match="/no/topic"):
        topics.type_of("/no/topic")
    for topic, kind in topics.TOPICS.items():
        assert topics.type_of(topic) == kind and definition(kind)
    assert topics.type_of("/nav/aid/laser") == "autopilot_msgs/AidStatus"


def test_buffer_aligns_and_replaces_nul() -> None:
    out = CdrBuffer()
    out.put("uint8", 1)
    out.put("float64", 2.0)
    out.string("a\0b")
    assert out.getvalue() == ENCAPSULATION + b"\1" + bytes(7) + struct.pack("<dI", 2.0, 4) + b"a b\0"
