"""The parameter protocol under all profiles."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mavlink_harness import NAN, Client, World, mav

from autopilot.core.crc import file_crc32
from autopilot.core.origin_params import params_origin, set_origin_deg, shortest_decimal
from autopilot.core.params import PARAMETERS, ParamSet, ParamType, Saved
from autopilot.mavlink.stubs import STUBS, VehicleFacts

INT32, REAL32 = mav.MAV_PARAM_TYPE_INT32, mav.MAV_PARAM_TYPE_REAL32
PROFILES = ("generic", "px4", "ardusub")


@pytest.fixture(name="world", params=PROFILES)
def world_fixture(request: pytest.FixtureRequest) -> World:
    return World(request.param)


def as_wire(world: World, value: float, wire_type: int) -> float:
    """What a client of this profile puts into param_value."""
    if wire_type == INT32 and world.server._ctx.profile.name != "ardusub":
        return struct.unpack("<f", struct.pack("<i", int(value)))[0]
    return value


def from_wire(world: World, message: object) -> float:
    if message.param_type == INT32 and world.server._ctx.profile.name != "ardusub":
        return struct.unpack("<i", struct.pack("<f", message.param_value))[0]
    return message.param_value


def set_param(client: Client, name: str, value: float, wire_type: int = REAL32) -> list:
    wire = as_wire(client.world, value, wire_type)
    return client.ask(mav.MAVLink_param_set_message(1, 1, name.encode(), wire, wire_type), "PARAM_VALUE", 0.05)


def test_the_list_is_complete_typed_and_stable(world: World, client: Client) -> None:
    for _ in range(2):
        got = client.ask(mav.MAVLink_param_request_list_message(1, 0), "PARAM_VALUE", 1.0)
        stubs = STUBS.get(world.server._ctx.profile.name, {})
        count = len(PARAMETERS) + len(stubs)
        assert [m.param_index for m in got] == list(range(count))
        assert {m.param_count for m in got} == {count}
        assert {m.param_id for m in got} == {spec.name for spec in PARAMETERS} | set(stubs)
        for m in got:
            stub = stubs.get(m.param_id)
            spec = world.params.spec(m.param_id) if stub is None else stub.spec
            value = world.params[m.param_id] if stub is None else stub.value(world.params, VehicleFacts())
            assert m.param_type == (INT32 if spec.type is ParamType.INT32 else REAL32)
            assert from_wire(world, m) == pytest.approx(value, rel=1e-6)


QGC_WANTS = """
    SYS_AUTOSTART CAL_GYRO0_ID COM_RC_IN_MODE SYS_AUTOCONFIG MAV_SYS_ID CAL_ACC0_ID CAL_MAG0_ID CAL_MAG1_ID CAL_MAG2_ID
    COM_FLTMODE1 COM_FLTMODE6 BAT1_N_CELLS BAT1_V_EMPTY BAT1_V_CHARGED RTL_LAND_DELAY RTL_DESCEND_ALT RTL_RETURN_ALT
    NAV_DLL_ACT COM_RC_LOSS_T NAV_RCL_ACT COM_LOW_BAT_ACT SYS_HAS_MAG RC_MAP_ROLL RC_MAP_THROTTLE
    CAL_MAG0_ROT CAL_MAG1_ROT CAL_MAG2_ROT SENS_BOARD_ROT SENS_BOARD_X_OFF SENS_BOARD_Y_OFF SENS_BOARD_Z_OFF
    SENS_DPRES_OFF RC_CHAN_CNT RC1_MIN RC1_TRIM RC1_MAX RC1_REV RC18_MIN RC18_TRIM RC18_MAX RC18_REV RC_MAP_PARAM3
    RC_MAP_FLTMODE RC_MAP_ARM_SW RC_MAP_GEAR_SW RC_MAP_KILL_SW RC_MAP_LOITER_SW RC_MAP_OFFB_SW RC_MAP_RETURN_SW
    RC_ARMSWITCH_TH RC_KILLSWITCH_TH BAT1_SOURCE BAT1_V_LOAD_DROP FRAME_CONFIG SDLOG_MODE GF_ACTION GF_MAX_HOR_DIST
    GF_MAX_VER_DIST COM_DISARM_LAND CP_DIST COM_OBS_AVOID BAT_LOW_THR BAT_CRIT_THR BAT_EMERGEN_THR COM_DL_LOSS_T
"""


def test_what_a_plug_in_wants_is_there_and_read_only() -> None:
    """QGroundControl's PX4 plug-in opens popups without them, at connect and on its setup pages."""
    client = World("px4").client()
    for name in QGC_WANTS.split():
        assert client.ask(mav.MAVLink_param_request_read_message(1, 1, name.encode(), -1), "PARAM_VALUE", 0.05), name
    client.rx.clear()
    set_param(client, "SYS_AUTOSTART", 4001, INT32)
    (error,) = client.got("PARAM_ERROR")
    assert error.error == 5 and "SYS_AUTOSTART is read only: it has no effect here" in client.texts()
    read = client.ask(mav.MAVLink_param_request_read_message(1, 1, b"SYS_AUTOSTART", -1), "PARAM_VALUE", 0.05)
    assert from_wire(client.world, read[0]) == 60_000


@pytest.mark.parametrize(
    ("ours", "value", "theirs", "shown"),
    [
        ("FS_GCS_ENABLE", 5.0, "NAV_DLL_ACT", 2),
        ("FS_GCS_ENABLE", 2.0, "NAV_DLL_ACT", 6),
        ("FS_GCS_TIMEOUT", 12.4, "COM_DL_LOSS_T", 12),
        ("FS_PILOT_INPUT", 3.0, "NAV_RCL_ACT", 1),
        ("FS_PILOT_TIMEOUT", 1.5, "COM_RC_LOSS_T", 1.5),
        ("FS_BATT_ACT", 3.0, "COM_LOW_BAT_ACT", 1),
        ("FS_BATT_LOW", 0.25, "BAT_CRIT_THR", 0.25),
        ("FS_BATT_CRT", 0.02, "BAT_EMERGEN_THR", 0.02),
        ("FS_CAGE_ACT", 1.0, "GF_ACTION", 2),
        ("MPC_MARGIN", 0.1, "CP_DIST", 0.1),
        ("SPD_PLANAR_MAX", 0.4, "MPC_XY_VEL_MAX", 0.4),
    ],
)
def test_a_plug_ins_parameter_says_what_ours_decides(ours: str, value: float, theirs: str, shown: float) -> None:
    world = World("px4")
    client = world.client()
    kind = INT32 if world.params.spec(ours).type is ParamType.INT32 else REAL32
    told = [m for m in set_param(client, ours, value, kind) if m.param_id == theirs]
    assert told and from_wire(world, told[-1]) == pytest.approx(shown)
    set_param(client, theirs, 0, told[-1].param_type)
    assert f"{theirs} is read only: set {ours}" in client.texts()
    assert world.params[ours] == pytest.approx(value)
    world.show(armed=False)
    assert client.command(mav.MAV_CMD_PREFLIGHT_STORAGE, 2.0) == 0
    assert theirs in {m.param_id for m in client.got("PARAM_VALUE")}, "with ours also when all are reset"


@pytest.mark.parametrize("gripper", [False, True])
@pytest.mark.parametrize(
    ("profile", "speed", "shown", "name"),
    [("px4", "MPC_XY_VEL_MAX", 0.5, "PD_GRIPPER_EN"), ("ardusub", "WPNAV_SPEED", 50.0, "GRIP_ENABLE")],
)
def test_parameters_that_show_a_button(profile: str, speed: str, shown: float, name: str, gripper: bool) -> None:
    """QGroundControl's *Change speed* and *Gripper*."""
    world = World(profile, facts=VehicleFacts(gripper=gripper))
    client = world.client()
    for wanted, value in ((speed, shown), (name, float(gripper))):
        read = client.ask(mav.MAVLink_param_request_read_message(1, 1, wanted.encode(), -1), "PARAM_VALUE", 0.05)
        assert from_wire(world, read[0]) == pytest.approx(value)


def test_parameters_longer_than_32_bits_are_refused_in_words(world: World, client: Client) -> None:
    client.send(mav.MAVLink_param_ext_request_list_message(1, 1))
    world.run(0.1)
    assert "PARAM_EXT is not served: use PARAM_REQUEST_LIST" in client.texts()
    for index, name in ((-1, b"SPD_CRUISE"), (3, b"")):  # at once: the text would be limited
        request = mav.MAVLink_param_ext_request_read_message(1, 1, name, index)
        (error,) = client.ask(request, "PARAM_ERROR", 0.1)
        missing = mav.MAV_PARAM_ERROR_DOES_NOT_EXIST
        assert (error.param_id, error.param_index, error.error) == (name.decode(), index, missing)
    real = mav.MAV_PARAM_EXT_TYPE_REAL32
    (ack,) = client.ask(
        mav.MAVLink_param_ext_set_message(1, 1, b"SPD_CRUISE", struct.pack("<f", 0.3), real), "PARAM_EXT_ACK", 0.1
    )
    assert (ack.param_id, ack.param_type, ack.param_result) == ("SPD_CRUISE", real, mav.PARAM_ACK_VALUE_UNSUPPORTED)
    assert world.params["SPD_CRUISE"] == world.params.spec("SPD_CRUISE").default


def test_every_action_of_a_failsafe_has_a_number_that_is_explained() -> None:
    for name, stub in STUBS["px4"].items():
        ours = stub.follows
        if stub.spec.type is not ParamType.INT32 or ours == "FS_GCS_TIMEOUT" or not ours:
            continue
        params = ParamSet()
        for choice in params.spec(ours).values:
            params.set(ours, choice)
            assert stub.value(params, VehicleFacts()) in stub.spec.values, (name, ours, choice)


def test_a_client_that_has_the_list_need_not_load_it(world: World, client: Client) -> None:
    got = client.ask(mav.MAVLink_param_request_list_message(1, 0), "PARAM_VALUE", 1.0)
    crc = 0  # as QGroundControl sums its own list up
    for m in sorted(got, key=lambda m: m.param_id):
        wire = struct.pack("<f", m.param_value)
        crc = file_crc32(m.param_id.encode() + wire, crc)
    answer = client.ask(mav.MAVLink_param_request_read_message(1, 1, b"_HASH_CHECK", -1), "PARAM_VALUE", 0.05)
    if world.server._ctx.profile.name == "ardusub":
        assert not answer
        return
    assert struct.unpack("<I", struct.pack("<f", answer[0].param_value))[0] == crc
    client.send(mav.MAVLink_param_request_list_message(1, 0))
    world.run(0.03)
    before = len(client.ask(answer[0].__class__(b"x", 0, 9, 0, 0), "PARAM_VALUE", 0.01))
    same = client.ask(mav.MAVLink_param_set_message(1, 1, b"_HASH_CHECK", answer[0].param_value, 5), "PARAM_VALUE", 0.3)
    assert before and len(same) <= 4


@pytest.mark.parametrize("name", ["ORIGIN_LAT", "ORIGIN_LON"])
@given(e7=st.integers(-890_000_000, 890_000_000), twice=st.booleans())
def test_an_origin_is_kept_to_its_last_digit(name: str, e7: int, twice: bool) -> None:
    """Listed by a client, saved, and set again: every profile gives 32-bit floats of degrees."""
    world = ORIGIN_WORLDS[twice]
    set_origin_deg(world.params, name, e7 * 1e-7)
    client = world.clients[0] if world.clients else world.client()
    for part, kind in ((name, REAL32), (f"{name}_REST", INT32)):
        ask = mav.MAVLink_param_request_read_message(1, 1, part.encode(), -1)
        value = from_wire(world, client.ask(ask, "PARAM_VALUE", 0.02)[0])
        world.params.set(part, 0.0)
        assert set_param(client, part, value, kind)
    place = params_origin(world.params)
    assert round((place.lat_deg if name == "ORIGIN_LAT" else place.lon_deg) * 1e7) == e7


ORIGIN_WORLDS = {False: World("px4"), True: World("ardusub")}


def test_the_list_is_throttled(world: World, client: Client) -> None:
    client.send(mav.MAVLink_param_request_list_message(1, 1))
    world.tick()
    assert 1 <= len(client.got("PARAM_VALUE")) <= 6


def test_reading_by_name_and_by_index(client: Client) -> None:
    by_name = client.ask(mav.MAVLink_param_request_read_message(1, 1, b"SPD_CRUISE", -1), "PARAM_VALUE", 0.05)
    assert len(by_name) == 1 and by_name[0].param_value == pytest.approx(0.35)
    index = by_name[0].param_index
    by_index = client.ask(mav.MAVLink_param_request_read_message(1, 1, b"", index), "PARAM_VALUE", 0.05)
    assert len(by_index) == 1 and by_index[0].param_id == "SPD_CRUISE"


def test_a_name_of_sixteen_characters_needs_no_end(world: World) -> None:
    assert max(len(spec.name) for spec in PARAMETERS) == 16
    client = world.client()
    name = next(spec.name for spec in PARAMETERS if len(spec.name) == 16)
    (value,) = client.ask(mav.MAVLink_param_request_read_message(1, 1, name.encode(), -1), "PARAM_VALUE", 0.05)
    assert value.param_id == name


@pytest.mark.parametrize(("name", "index"), [(b"NO_SUCH", -1), (b"", 9999), (b"", -7), (b"\xff\xfe", -1)])
def test_reading_what_does_not_exist(client: Client, name: bytes, index: int) -> None:
    (error,) = client.ask(mav.MAVLink_param_request_read_message(1, 1, name, index), "PARAM_ERROR", 0.05)
    assert error.error == mav.MAV_PARAM_ERROR_DOES_NOT_EXIST
    assert (error.target_system, error.target_component) == (255, 190)
    assert not client.got("PARAM_VALUE")


def test_setting_tells_everyone() -> None:
    world = World(links=(0, 1))
    client, other = world.client(), world.client(link=1, sysid=254)
    (value,) = set_param(client, "SPD_CRUISE", 0.3)
    assert value.param_value == struct.unpack("<f", struct.pack("<f", 0.3))[0]
    assert world.params["SPD_CRUISE"] == 0.3
    assert [m.param_id for m in other.got("PARAM_VALUE")] == ["SPD_CRUISE"]


class Disk:
    """Keeps parameters whenever it is told to."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.answers: list[Saved] = []

    def save(self, tick: int, name: str) -> int | None:
        self.asked.append(name)
        return len(self.asked)

    def saved(self, tick: int) -> Saved | None:
        return self.answers.pop(0) if self.answers else None


def test_a_value_is_told_when_it_is_on_disk_and_not_before() -> None:
    disk = Disk()
    world = World(saving=disk)
    client = world.client()
    assert set_param(client, "SPD_CRUISE", 0.3) == []
    assert set_param(client, "THR_LIMIT", 9.0) == []
    assert world.params["SPD_CRUISE"] == 0.3 and disk.asked == ["SPD_CRUISE", "THR_LIMIT"]
    disk.answers.append(Saved(number=1, failure=""))
    world.run(0.05)
    assert [m.param_id for m in client.got("PARAM_VALUE")] == ["SPD_CRUISE"]
    disk.answers.append(Saved(number=2, failure="disk full"))
    world.run(0.05)
    assert [m.param_id for m in client.got("PARAM_VALUE")] == ["SPD_CRUISE", "THR_LIMIT"]
    assert "Not saved (disk full), lost at restart: THR_LIMIT" in client.texts()
    assert set_param(client, "SPD_CRUISE", 99.0)[-1].param_value == pytest.approx(0.3)
    assert disk.asked == ["SPD_CRUISE", "THR_LIMIT"]


def test_a_disk_that_does_not_answer_is_spoken_of_once() -> None:
    world = World(saving=Disk())
    client = world.client()
    set_param(client, "SPD_CRUISE", 0.3)
    world.run(10.0)
    assert client.texts().count("SPD_CRUISE in force, not on disk yet") == 1


def test_integers_travel_as_the_profile_says(world: World, client: Client) -> None:
    (value,) = set_param(client, "FS_SOLVER_N", 77, INT32)
    assert world.params["FS_SOLVER_N"] == 77.0
    assert from_wire(world, value) == 77
    assert (value.param_value == 77.0) == (world.server._ctx.profile.name == "ardusub")


@pytest.mark.parametrize(
    ("name", "value", "wire_type"),
    [
        ("SPD_CRUISE", 99.0, REAL32),
        ("SPD_CRUISE", NAN, REAL32),
        ("SPD_CRUISE", math.inf, REAL32),
        ("FS_SOLVER_N", 4, INT32),
        ("FS_SOLVER_N", 2_000_000_000, INT32),
    ],
)
def test_a_refusal_says_the_value_in_force_and_why(world: World, name: str, value: float, wire_type: int) -> None:
    client = world.client()
    before = world.params[name]
    (shown,) = set_param(client, name, value, wire_type)
    (error,) = client.got("PARAM_ERROR")
    assert error.error == mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE and error.param_id == name
    assert from_wire(world, shown) == pytest.approx(before) and world.params[name] == before
    assert name in client.texts()


def test_setting_what_does_not_exist(client: Client) -> None:
    assert set_param(client, "NO_SUCH", 1.0) == []
    assert client.got("PARAM_ERROR")[0].error == mav.MAV_PARAM_ERROR_DOES_NOT_EXIST
    assert "There is no parameter NO_SUCH" in client.texts(), "MAVLink 1 has no PARAM_ERROR"


@pytest.mark.parametrize(("name", "wire_type"), [("FS_SOLVER_N", REAL32), ("SPD_CRUISE", INT32)])
def test_another_type_is_refused_where_bytes_are_shared(name: str, wire_type: int) -> None:
    world = World("px4")
    client = world.client()
    before = dict(world.params)
    (shown,) = client.ask(mav.MAVLink_param_set_message(1, 1, name.encode(), 0.25, wire_type), "PARAM_VALUE", 0.05)
    assert client.got("PARAM_ERROR")[0].error == 7
    assert shown.param_id == name and dict(world.params) == before


def test_any_number_type_is_taken_where_values_are_cast() -> None:
    """MAVProxy sends REAL32 for every parameter of an ArduPilot vehicle."""
    world = World("ardusub")
    client = world.client()
    set_param(client, "FS_SOLVER_N", 50.0, REAL32)
    assert world.params["FS_SOLVER_N"] == 50.0
    set_param(client, "FS_SOLVER_N", 50.5, REAL32)
    assert world.params["FS_SOLVER_N"] == 50.0 and client.got("PARAM_ERROR")


def test_bounds_can_be_set_although_the_wire_rounds_them() -> None:
    """0.01 as float32 is 0.0099999998: below the bound unless read as the number that was meant."""
    world = World("px4")
    client = world.client()
    set_param(client, "WP_ACCEPT_YAW", 0.01)
    assert world.params["WP_ACCEPT_YAW"] == 0.01 and not client.got("PARAM_ERROR")


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_the_shortest_decimal_is_the_same_float32(value: float) -> None:
    assert struct.pack("<f", shortest_decimal(value)) == struct.pack("<f", value)
