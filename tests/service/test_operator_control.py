"""Whoever is not in control changes nothing: derived from what the service handles, by machine-made messages."""

import random
from typing import Any

from piloted_world import HOLD, OFFBOARD, PilotedWorld
from pymavlink.dialects.v20 import development as mav
from service_world import ServiceWorld

from autopilot.core.plan import PlanKind
from autopilot.mavlink.operators import OPEN
from tests.bench.fuzz.messages import COMMANDS, HANDLED, Sender, Traffic

OWNER, STRANGER = 255, 66
TAKE = 32100


def state(world: ServiceWorld) -> dict[str, Any]:
    """All that a client can change."""
    parts, inside = world.parts, world.parts.server
    commander = parts.commander
    return {
        "parameters": tuple(world.params.values()),
        **{kind.name: parts.plans.items(kind) for kind in PlanKind},
        "home": parts.plans.home_ned_m.tolist(),
        "origin": parts.plans.origin,
        "armed": commander.armed,
        "mode": commander.intended_mode,
        "sticks": parts.server.pilot.sticks,
        "gain": inside.pilot._gain,
        "key": inside._ctx.signing.key,
        "erasing": inside._logs._erasing,
        "uploading": parts.server.missions.uploading,
        "in control": inside._operators.in_control,
    }


def stranger() -> Any:
    return mav.MAVLink(None, srcSystem=STRANGER, srcComponent=190)


def owned() -> ServiceWorld:
    world = ServiceWorld()
    world.run(2.0)
    assert world.command(TAKE, 1.0) == mav.MAV_RESULT_ACCEPTED
    return world


def beat(world: ServiceWorld) -> bytes:
    return world.pack(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))


def test_nothing_that_is_handled_changes_anything_for_a_stranger() -> None:
    """Every message and command that the server knows, of any content, while somebody else is in control."""
    world = owned()
    world.run(0.1)
    traffic = Traffic(3, senders=(Sender(STRANGER),))
    inside = world.parts.server
    ids, commands = sorted(inside._handlers), sorted(inside._commands.table)
    rng = random.Random(4)
    before = state(world)
    for turn in range(10):
        for number in ids:
            world.tick([traffic.any_of(number), *([beat(world)] if number == ids[0] else ())])
            assert state(world) == before, mav.mavlink_map[number].msgname
        for number in commands:
            values = [rng.choice((0.0, 1.0, 21196.0, 2.0, 0.3)) for _ in range(7)]
            asked = mav.MAVLink_command_long_message(1, 1, number, 0, *values)
            world.tick([bytes(asked.pack(stranger()))])
            assert state(world) == before, (turn, number)


def test_what_is_heard_of_everybody_changes_nothing_of_the_vehicle() -> None:
    """Messages that a stranger may send change nothing even while nobody is in control. Commands are judged each."""
    world = ServiceWorld()
    world.run(2.0)
    traffic = Traffic(5, senders=(Sender(STRANGER),))
    before = state(world)
    apart = {mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT}
    for _ in range(10):
        for number in sorted(OPEN - apart):
            world.tick([traffic.any_of(number)])
            assert state(world) == before, mav.mavlink_map[number].msgname
    assert set(HANDLED) >= OPEN and COMMANDS


def test_a_stranger_does_not_end_what_the_one_in_control_flies() -> None:
    """SET_ACTUATOR_CONTROL_TARGET is refused, and a refused set point ends Offboard: not a stranger's."""
    world = PilotedWorld()
    world.run(3.0)
    assert world.command(TAKE, 1.0) == 0
    assert world.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == 0
    point = mav.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0b0000_1101_1111_1000, -1.2, 0.5, 0.5, *[0] * 8
    )
    world.tick([world.pack(point)])
    assert world.command(mav.MAV_CMD_DO_SET_MODE, 1.0, OFFBOARD >> 16 & 0xFF, OFFBOARD >> 24) == 0
    actuators = mav.MAVLink_set_actuator_control_target_message(0, 0, 1, 1, [0.0] * 8)
    bad = mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 99, 0, *[0] * 11)
    for _ in range(10):
        world.tick([world.pack(point), beat(world)])
        world.tick([bytes(actuators.pack(stranger())), bytes(bad.pack(stranger()))])
        world.run(0.05)
    assert world.parts.server.custom_mode(world.parts.commander.mode) == OFFBOARD
    world.tick([world.pack(actuators)])
    world.run(0.1)
    assert world.parts.server.custom_mode(world.parts.commander.mode) == HOLD, "the one in control may"
