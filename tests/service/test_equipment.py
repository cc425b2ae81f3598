"""Servos, relays, gripper, lights and the gimbal that is not there: commands through the whole service."""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import development as mav
from service_world import ServiceWorld

from autopilot.core.errors import ConfigError
from autopilot.core.toml_table import convert
from autopilot.core.vehicle import PayloadTable
from autopilot.log.reader import open_log
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl

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
        (mav.MAV_CMD_DO_REPEAT_RELAY, (0, 0, 1), "0 times"),
        (mav.MAV_CMD_DO_REPEAT_SERVO, (17, 1500, 2, 0.0), "cycle 0 s"),
        (mav.MAV_CMD_DO_GRIPPER, (2, 1), "no gripper 2"),
        (mav.MAV_CMD_DO_GRIPPER, (1, 5), "action 5"),
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
    ],
)
def test_a_wrong_table_is_told(table: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        convert(table, PayloadTable, "file")


def test_a_simulated_gripper_moves_and_its_state_is_in_the_log(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    settings = flight_settings(tmp_path, {"scenario": "paper-tank", "sensors": "pose", "log": str(log)})
    client = WireGripper()
    session = open_sitl(settings, {}, peers=(client,))
    for tick in range(1, 351):
        session.runtime.tick(10_000 * tick)
    session.runtime.close()
    session.recorder.close()
    found = open_log(log)
    commanded = found["/payload/outputs"]
    assert commanded["pulse_us"][-1].tolist()[:4] == [1100, 1100, 1100, 0]
    shares = found["/sim/payload"]["share"][:, GRABBER]
    assert shares[0] == 1.0 and shares[-1] == 0.0
    assert ((shares > 0.0) & (shares < 1.0)).sum() > 100, "a gripper takes its time"


class WireGripper:
    """A client that closes the gripper once."""

    def __init__(self) -> None:
        self._mav = mav.MAVLink(None, srcSystem=255, srcComponent=190)

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        if t_us != 500_000:
            return []
        message = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_GRIPPER, 0, 1.0, 1.0, 0, 0, 0, 0, 0)
        return [bytes(message.pack(self._mav))]
