"""Servos, relays, gripper, lights, and a camera that tilts or is fixed: commands through the whole service."""

import math
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import development as mav
from service_world import ORIGIN, ServiceWorld

from autopilot.command.payload_orders import PayloadOrders
from autopilot.core.errors import ConfigError
from autopilot.core.samples import CameraTiltSample, Sample
from autopilot.core.toml_table import convert
from autopilot.core.vehicle import PayloadTable
from autopilot.log.reader import open_log
from autopilot.mission.decode import ItemRefusedError
from autopilot.mission.item_types import parse_step
from autopilot.mission.payload_items import TiltCamera
from tests.plan_items import plain
from tests.system.system_harness import sessions
from tests.system.wire_client import Harbour, WireClient

LIGHTS, GRABBER, RELAY = 0, 1, 2
"""Place in the file of the lbv150, which has them on channels 17, 18 and 19."""
NAN = math.nan


@pytest.fixture(name="world", scope="module")
def world_fixture() -> ServiceWorld:
    world = ServiceWorld()
    world.run(0.1)
    return world


def pulses(world: ServiceWorld) -> tuple[int, ...]:
    state = world.tick().payload
    assert state is not None
    return state.pulses_us


def test_orders_become_pulses(world: ServiceWorld) -> None:
    assert pulses(world) == (1100, 1900, 1100)
    assert world.command(mav.MAV_CMD_DO_SET_SERVO, 17, 1500) == 0
    assert pulses(world)[LIGHTS] == 1500
    assert world.command(mav.MAV_CMD_DO_GRIPPER, 1, 1) == 0
    assert pulses(world)[GRABBER] == 1100
    assert world.command(mav.MAV_CMD_DO_GRIPPER, 0, 0) == 0
    assert pulses(world)[GRABBER] == 1900
    assert world.command(mav.MAV_CMD_DO_SET_RELAY, 0, 1) == 0
    assert pulses(world)[RELAY] == 1900
    assert world.command(mav.MAV_CMD_DO_SET_RELAY, 0, -1) == 0
    assert pulses(world)[RELAY] == 1100
    assert world.command(mav.MAV_CMD_DO_SET_ACTUATOR, 1.0, NAN, NAN, NAN, NAN, NAN, 0) == 0
    assert pulses(world) == (1900, 1900, 1100)
    # A client without NaN: zeros for actuators that there are not.
    assert world.command(mav.MAV_CMD_DO_SET_ACTUATOR, -1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0) == 0
    assert pulses(world) == (1100, 1100, 1100)


@pytest.mark.parametrize(
    ("command", "params", "reason"),
    [
        (mav.MAV_CMD_DO_SET_SERVO, (1, 1500), "drives thruster"),
        (mav.MAV_CMD_DO_SET_SERVO, (7, 1500), "no servo 7: use 17, 18, 19"),
        (mav.MAV_CMD_DO_SET_SERVO, (17, 3000), "3000 us, use 1100 to 1900"),
        (mav.MAV_CMD_DO_SET_SERVO, (17, math.inf), "use 1100 to 1900"),
        (mav.MAV_CMD_DO_SET_RELAY, (3, 1), "no relay 3: use 0"),
        (mav.MAV_CMD_DO_SET_RELAY, (0, 7), "setting 7"),
        (mav.MAV_CMD_DO_SET_RELAY, (1.5, 1), "Relay refused: 1.5 (param1), use a whole number"),
        (mav.MAV_CMD_DO_REPEAT_RELAY, (0, 0, 1), "0 times"),
        (mav.MAV_CMD_DO_REPEAT_SERVO, (17, 1500, 2, 0.0), "cycle 0 s"),
        (mav.MAV_CMD_DO_GRIPPER, (2, 1), "no gripper 2"),
        (mav.MAV_CMD_DO_GRIPPER, (1, 5), "action 5"),
        (mav.MAV_CMD_DO_GRIPPER, (1.5, 1), "Gripper refused: 1.5 (param1), use a whole number"),
        (mav.MAV_CMD_DO_SET_ACTUATOR, (2.0, NAN, NAN, NAN, NAN, NAN, 0), "use -1 to 1"),
        (mav.MAV_CMD_DO_SET_ACTUATOR, (0.5, NAN, NAN, NAN, NAN, NAN, 2), "no actuator 13"),
        (mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, (0.0,), "no gimbal"),
        (mav.MAV_CMD_DO_MOUNT_CONTROL, (0.0,), "no gimbal"),
        (mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, (0.0,), "no gimbal"),
    ],
)
def test_what_cannot_be_done_is_refused_and_nothing_moves(
    world: ServiceWorld, command: int, params: tuple[float, ...], reason: str
) -> None:
    world.run(5.1)  # the same reason is not said again within 5 s
    before = pulses(world)
    assert world.command(command, *params) == mav.MAV_RESULT_DENIED
    assert reason in world.texts()
    assert pulses(world) == before


class TiltWorld(ServiceWorld):
    """With a camera that tilts by +-45 degrees, and what is reported of it."""

    vehicle_name = "bluerov2"
    reported_rad: float | None = None

    def samples(self) -> tuple[Sample, ...]:
        if self.reported_rad is None:
            return super().samples()
        return (*super().samples(), CameraTiltSample(t_us=self.t_us, angle_rad=self.reported_rad))


@pytest.fixture(name="tilting", scope="module")
def tilting_fixture() -> TiltWorld:
    world = TiltWorld()
    world.run(0.1)
    return world


def tilt_us(world: ServiceWorld) -> int:
    return pulses(world)[3]


def test_a_camera_is_tilted_by_old_and_new_commands_and_by_buttons(tilting: TiltWorld) -> None:
    world = tilting
    assert tilt_us(world) == 0, "as it is until somebody tilts it"
    assert world.command(mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, -45.0, NAN, NAN, NAN) == 0
    assert tilt_us(world) == 1100
    assert world.command(mav.MAV_CMD_DO_MOUNT_CONTROL, 22.5, 0, 0, 0, 0, 0, 2) == 0
    assert tilt_us(world) == 1700
    assert world.command(mav.MAV_CMD_DO_MOUNT_CONTROL, 22.5, 0, 0, 0, 0, 0, 1) == 0
    assert tilt_us(world) == 1500
    assert world.command(mav.MAV_CMD_DO_SET_SERVO, 16, 1300) == 0
    assert tilt_us(world) == 1300
    neutral = mav.MAVLink_command_int_message(1, 1, 0, 1000, 0, 0, NAN, NAN, NAN, NAN, 2, 0, 0.0)
    world.ask(neutral)
    assert tilt_us(world) == 1500
    assert world.command(mav.MAV_CMD_DO_SET_SERVO, 16, 1300) == 0
    assert world.command(mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, NAN, NAN, NAN, NAN, 2.0) == 0, "neutral"
    assert tilt_us(world) == 1500
    for button, function in enumerate((21, 22, 23)):
        world.params.set(f"BTN{button}_FUNCTION", function)
    for pressed, pulse_us in ((2, 1544), (2, 1588), (4, 1544), (1, 1500)):
        for buttons in (pressed, 0):
            world.tick([world.pack(mav.MAVLink_manual_control_message(1, 0, 0, 500, 0, buttons))])
            world.run(0.1)
        assert abs(tilt_us(world) - pulse_us) <= 1


def test_the_angle_that_is_reported_is_shown(tilting: TiltWorld) -> None:
    world = tilting
    world.reported_rad = math.radians(22.5)
    world.run(0.1)
    for number in (mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION, mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS):
        assert world.command(mav.MAV_CMD_REQUEST_MESSAGE, number) == 0
        found = {m.get_type(): m for m in world.inbox}
        if number == mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION:
            ends = found["GIMBAL_MANAGER_INFORMATION"]
            assert (math.degrees(ends.pitch_min), math.degrees(ends.pitch_max)) == pytest.approx((-45.0, 45.0))
    shown = found["GIMBAL_DEVICE_ATTITUDE_STATUS"].q
    assert shown == pytest.approx([math.cos(math.radians(11.25)), 0.0, math.sin(math.radians(11.25)), 0.0])
    assert world.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT) == 0
    values = {m.name: m.value for m in world.inbox if m.get_type() == "NAMED_VALUE_FLOAT"}
    assert values["CamTilt"] == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("command", "params", "reason"),
    [
        (mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, (-60.0, NAN, NAN, NAN), "-60.0 deg, use -45 to 45"),
        (mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, (NAN, NAN, 5.0, NAN), "no rate"),
        (mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, (0.0, 30.0, NAN, NAN), "does not pan"),
        (mav.MAV_CMD_DO_MOUNT_CONTROL, (math.inf, 0, 0, 0, 0, 0, 2), "use -45 to 45"),
        (mav.MAV_CMD_DO_MOUNT_CONTROL, (0.0, 0, 0, 0, 0, 0, 4), "mode 4 (param7)"),
        (mav.MAV_CMD_DO_MOUNT_CONFIGURE, (3.0,), "mode 3, use 2"),
    ],
)
def test_a_tilt_that_there_is_not_is_refused_in_words(
    tilting: TiltWorld, command: int, params: tuple[float, ...], reason: str
) -> None:
    tilting.run(5.1)
    before = tilt_us(tilting)
    assert tilting.command(command, *params) == mav.MAV_RESULT_DENIED
    assert reason in tilting.texts()
    assert tilt_us(tilting) == before


def test_mission_items_tilt_the_camera_and_what_it_cannot_reach_is_refused(tilting: TiltWorld) -> None:
    orders = PayloadOrders(tilting.parts.equipment, None)
    at_angle = [plain(0, 205, 30.0, 0.0, 0.0, 0.0), plain(0, 1000, 30.0, 0.0, NAN, NAN)]
    for item in at_angle:
        tilting.command(mav.MAV_CMD_DO_SET_SERVO, 16, 1500)
        order = parse_step(item, ORIGIN)
        assert order == TiltCamera(seq=0, angle_rad=math.radians(30.0))
        assert orders.refusal(order) == "" and orders.carry_out(tilting.t_us, [order]) == []
        assert abs(tilt_us(tilting) - 1767) <= 1
    away = parse_step(plain(0, 205, -90.0, 0.0, 0.0, 0.0), ORIGIN)
    assert isinstance(away, TiltCamera)
    assert "use -45 to 45" in orders.refusal(away)
    for item in (plain(0, 1000, NAN, 0.0, 10.0, NAN), plain(0, 1000, 0.0, 20.0, NAN, NAN)):
        with pytest.raises(ItemRefusedError):
            parse_step(item, ORIGIN)


def test_repetitions_go_to_and_fro_and_end_where_they_began(world: ServiceWorld) -> None:
    world.command(mav.MAV_CMD_DO_SET_RELAY, 0, 0)
    assert world.command(mav.MAV_CMD_DO_REPEAT_RELAY, 0, 3, 0.4) == 0
    seen = [pulses(world)[RELAY] for _ in range(150)]
    changes = [a for a, b in pairwise(seen) if a != b]
    assert changes == [1900, 1100, 1900, 1100, 1900]
    assert seen[-1] == 1100
    world.command(mav.MAV_CMD_DO_SET_SERVO, 17, 1200)
    world.command(mav.MAV_CMD_DO_REPEAT_SERVO, 17, 1600, 100, 0.2)
    world.run(0.5)
    assert world.command(mav.MAV_CMD_DO_SET_SERVO, 17, 1300) == 0  # another order ends it
    assert {pulses(world)[LIGHTS] for _ in range(50)} == {1300}


def test_outputs_that_nothing_drives_are_refused_with_the_reason() -> None:
    world = ServiceWorld()
    world.parts.equipment.leave_out({"grabber": "the thruster output has no channel for it"})
    world.run(0.1)
    assert world.command(mav.MAV_CMD_DO_GRIPPER, 1, 1) == mav.MAV_RESULT_DENIED
    assert "no channel for it" in world.texts()
    assert world.command(mav.MAV_CMD_DO_SET_RELAY, 0, 1) == 0


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"name": "a", "kind": "light"}, "`channel` is missing"),
        ({"name": "a", "kind": "relay", "channel": 9}, "go together"),
        ({"name": "a", "kind": "servo", "channel": 9, "min_us": 1900, "max_us": 1100}, "has to be below"),
        ({"name": "a", "kind": "servo", "channel": 9, "rest_us": 2000}, "not within"),
        ({"name": "a", "kind": "winch", "channel": 9}, "winch"),
        ({"name": "a", "kind": "tilt", "channel": 9, "min_deg": 45.0}, "are equal"),
        ({"name": "a", "kind": "tilt", "channel": 9, "camera_deg": -90.0}, "no angle of a `tilt`"),
        ({"name": "a", "kind": "servo", "channel": 9, "camera_deg": 0.0}, "no angle of a `tilt`"),
    ],
)
def test_a_wrong_table_is_told(table: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        convert(table, PayloadTable, "file")


def test_a_simulated_gripper_moves_and_its_state_is_in_the_log(tmp_path: Path) -> None:
    log, client = tmp_path / "run.mcap", WireClient()
    with sessions(tmp_path) as session:
        harbour = Harbour(session(sensors="pose", log=log, peers=(client,)))
        harbour.run(0.5)
        client.send(mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_GRIPPER, 0, 1.0, 1.0, 0, 0, 0, 0, 0))
        harbour.run(3.0)
    found = open_log(log)
    commanded = found["/payload/outputs"]
    assert commanded["pulse_us"][-1].tolist()[:4] == [1100, 1100, 1100, 0]
    shares = found["/sim/payload"]["share"][:, GRABBER]
    assert shares[0] == 1.0 and shares[-1] == 0.0
    assert ((shares > 0.0) & (shares < 1.0)).sum() > 100, "a gripper takes its time"
