"""CDR bytes against rosbags, an implementation of ROS 2 serialisation that is not ours."""

import math
import struct
from enum import Enum
from types import NoneType, SimpleNamespace
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_synthetic import Truth
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import (
    Event,
    NavCounters,
    NavDoubt,
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
from autopilot.log.packing import records
from autopilot.log.packing.records import LARGEST, pack_record
from autopilot.log.record_table import RECORD_ROWS, RecordRow
from autopilot.log.sample_table import SAMPLE_ROWS, SampleRow
from autopilot.log.schemas import definition, layout, ros_name, type_names, types_of
from autopilot.log.topics import AID_PREFIX, TOPICS
from autopilot.replay.inputs import SAMPLES
from tests.plan_items import nav
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


RECORDS = [row for row in RECORD_ROWS if row.of is not None]


@st.composite
def attributes_of(draw: st.DrawFn, row: RecordRow) -> dict[str, Any]:
    """Attribute -> any value that an object of the row's class may have; arrays as long as their fields."""
    fields: Any = layout(f"autopilot_msgs/{row.type}").dtype.fields
    hints = get_type_hints(row.of)
    for name in fields.keys() - hints.keys():
        if isinstance(getattr(row.of, name, None), property):
            hints[name] = get_type_hints(getattr(row.of, name).fget)["return"]
    found: dict[str, Any] = {}
    for name, hint in sorted(hints.items()):
        given = [kind for kind in get_args(hint) if kind is not NoneType] if NoneType in get_args(hint) else [hint]
        (kind, *_), size = given, int(np.prod(fields[name][0].shape)) if name in fields else 3
        if kind in (bool, int, float):
            value = draw({int: st.integers(0, 2**31 - 1), float: finite, bool: st.booleans()}[kind])
        elif isinstance(kind, type) and issubclass(kind, Enum):
            value = draw(st.sampled_from(kind))
        elif get_origin(kind) in (tuple, frozenset):
            number = get_args(kind)[0]
            value = (
                tuple(draw(st.lists(u16 if number is int else finite, max_size=size))) if number in (int, float) else ()
            )
        else:
            value = draw(vec(size))
        found[name] = None if given != [hint] and draw(st.booleans()) else value
    return found


@pytest.mark.parametrize("row", RECORDS, ids=lambda row: row.type)
@given(stamp=stamps, data=st.data())
@settings(max_examples=15, deadline=None)
def test_a_record_of_any_kind_comes_back(row: RecordRow, stamp: int, data: st.DataObject) -> None:
    """Every field has the attribute of its name: None as NaN or zeros, counts cut to what it holds, zeros behind."""
    name, meant = f"autopilot_msgs/{row.type}", data.draw(attributes_of(row))
    topic = row.topics[0] if row.topics else AID_PREFIX + "markers"
    read = read_back(name, pack_record(topic, stamp, SimpleNamespace(**meant)))
    assert stamp_of(read.header) == stamp and read.header.frame_id == row.frame
    for field in types_of(name)[name][1:]:
        if field.name in row.put:
            continue
        value, found = meant[field.name], np.ravel(getattr(read, field.name))
        none = 0.0 if field.count else np.nan
        expected = np.full(1, none) if value is None else np.ravel(value).astype(float)
        if field.type in LARGEST:
            expected = np.minimum(expected, LARGEST[field.type])
        assert len(found) == (field.count or 1)
        np.testing.assert_array_equal(found, [*expected, *[0.0] * len(found)][: len(found)])


@given(stamps, u32, u32, st.none() | finite)
@settings(max_examples=25, deadline=None)
def test_fields_that_are_computed(stamp: int, a: int, b: int, yaw: float | None) -> None:
    def packed(topic: str, **value: Any) -> Any:
        return read_back(TOPICS[topic], pack_record(topic, stamp, SimpleNamespace(**value)))

    doubts = frozenset(doubt for bit, doubt in enumerate(NavDoubt) if a >> bit & 1)
    assert packed("/nav/status", health=2, reset_count=b, doubts=doubts).doubts == a % (1 << len(NavDoubt))
    mode = packed("/sys/mode", armed=True, custom_mode=a, failsafes=b | 1 << 32)
    assert (mode.custom_mode, mode.failsafes) == (a, b)
    goal = {"pos_ned_m": np.zeros(3), "speed_m_s": 0.0, "accept_radius_m": 0.0, "accept_yaw_rad": 0.0, "seq": -1}
    read = packed("/ctl/goal", yaw_rad=yaw, **goal)
    assert (read.yaw_free, read.yaw_rad, read.seq) == (*((1, 0.0) if yaw is None else (0, yaw)), -1)
    idle = {"log_queue": 0, "log_queue_bytes": 0, "threads": 1, "collect_s": 0.0, "thread_cpu_s": (0.0,) * 11}
    assert packed("/sys/process", rss_bytes=a, **idle).rss == a
    tick = packed("/in/tick", samples=(0,) * 3, mavlink_rx=(0,), overruns=0, cpu_load=0.0)
    assert (tick.samples, tick.frames) == (3, 1)


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


@given(stamps, st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3), vec(3), finite, finite)
@settings(max_examples=25, deadline=None)
def test_what_viewers_get_of_samples(stamp: int, rpy: list[float], v: Any, x: float, y: float) -> None:
    ahrs = AhrsSample(t_us=0, rpy_rad=np.array(rpy), rate_frd_rad_s=v, accel_frd_m_s2=-v)
    imu = read_back("sensor_msgs/Imu", records.imu(stamp, ahrs))
    q = imu.orientation
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    assert yaw == pytest.approx(rpy[2], abs=1e-9)
    assert (imu.linear_acceleration.x, imu.linear_acceleration.z) == (-v[0], -v[2])
    laser = LaserSample(t_us=0, range_m=x, sigma_m=y)
    assert read_back("sensor_msgs/Range", records.laser_range(stamp, laser)).range == np.float32(x)
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


@given(stamps, u32)
@settings(max_examples=25, deadline=None)
def test_counters(stamp: int, count: int) -> None:
    counts = {"ahrs.stuck": count, "depth.rejected": count, "laser.resets": 2, "unknown": 9}
    counters = NavCounters(t_us=0, counts=counts)
    read = read_back("autopilot_msgs/NavCounters", pack_record("/nav/counters", stamp, counters))
    assert (read.ahrs_stuck, read.rejected[AID_SENSORS.index("depth")], read.aid_resets[6]) == (count, count, 2)
    assert read.ahrs_good == read.received.sum() == 0 and read.other == 9


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
    read = read_back("autopilot_msgs/MarkerSighting", records.marker_sighting(stamp, sighting))
    kept = min(count, records.MAX_MARKERS)
    assert (read.count, read.laser_found, read.decode_us) == (kept, int(laser), decode_us)
    assert read.ids[:kept].tolist() == list(range(kept)) and not read.ids[kept:].any()
    np.testing.assert_array_equal(read.corners_px[: 8 * kept], corners[:kept].ravel())
    assert read.laser_px.tolist() == ([1.5, 2.5] if laser else [0.0, 0.0])
    assert read.sigma_px.tolist() == [0.25 if laser else 0.0] * kept + [0.0] * (records.MAX_MARKERS - kept)
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
    state = nav(1.0, 2.0, 3.0, math.pi / 2)
    pose = read_back("geometry_msgs/PoseStamped", visuals.pose_stamped(5, state))
    assert (pose.pose.position.y, pose.pose.orientation.z) == (2.0, pytest.approx(math.sqrt(0.5)))
    tf = read_back("tf2_msgs/TFMessage", visuals.transforms(5, state))
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
