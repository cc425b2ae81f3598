"""The command protocol itself: every command by either carrier, to every target, once or again, and its end."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_harness import Client, World, mav

from autopilot.core.messages import RunEnd
from autopilot.core.params import PARAMETERS
from autopilot.mavlink.api import CommandReply, CommandResult, FlightMode
from autopilot.mavlink.dialect import extra
from tests.bench.fuzz.messages import ALL_COMMANDS, COMMANDS

numbers = st.sampled_from((0.0, 1.0, 2.0, -1.0, 3.0, 129.0, 512.0, math.nan, math.inf, 1e9))
RESULTS = set(range(11)) - {5, 6}
"""Of a command that is answered at once."""
OURS = [(system, component) for system in (0, 1) for component in (0, 1, 190)]
OTHERS = [(9, 1), (1, 100), (0, 154), (255, 190)]


def message(command: int, params: list[float], to: tuple[int, int], frame: int | None, again: int) -> object:
    """COMMAND_INT with a frame, else COMMAND_LONG."""
    if frame is None:
        return mav.MAVLink_command_long_message(*to, command, again, *params, *(math.nan,) * 3)
    return mav.MAVLink_command_int_message(*to, frame, command, 0, 0, *params, 0x7FFF_FFFF, 0x7FFF_FFFF, math.nan)


@settings(max_examples=60, deadline=None)
@given(
    command=st.one_of(st.sampled_from(COMMANDS), st.sampled_from(ALL_COMMANDS)),
    params=st.lists(numbers, min_size=4, max_size=4),
    to=st.sampled_from(OURS + OTHERS),
    frame=st.sampled_from((None, 0, 1, 2, 3, 5, 6, 8, 20, 255)),
    mode=st.sampled_from(list(FlightMode)),
    armed=st.booleans(),
)
def test_one_answer_to_the_asker_and_one_execution(
    command: int, params: list[float], to: tuple[int, int], frame: int | None, mode: FlightMode, armed: bool
) -> None:
    world = World()
    world.show(armed=armed, mode=mode, intended_mode=mode)
    client = world.client(sysid=77, compid=88)
    world.run(0.02)
    client.rx.clear()
    again = 0
    first = client.send(message(command, params, to, frame, again))
    client.send_raw(first)  # the network made two of it
    world.run(0.05)
    acks = [ack for ack in client.got("COMMAND_ACK") if ack.command == command]
    if to in OTHERS:
        assert not acks and not world.vehicle.calls
        return
    assert len(acks) == 2 and acks[0].result == acks[1].result and acks[0].result in RESULTS, acks
    assert all((ack.target_system, ack.target_component) == (77, 88) for ack in acks)
    calls = list(world.vehicle.calls)
    assert len(calls) == len(set(map(repr, calls))), "carried out twice"
    if frame is None:  # and what its client sends again for want of an answer
        client.send(message(command, params, to, frame, 1))
        world.run(0.05)
        acks = [ack for ack in client.got("COMMAND_ACK") if ack.command == command]
        assert len(acks) == 3 and acks[2].result == acks[0].result
        assert world.vehicle.calls == calls


@pytest.mark.parametrize(
    ("command", "mode"),
    [
        (mav.MAV_CMD_NAV_TAKEOFF, FlightMode.TAKEOFF),
        (mav.MAV_CMD_DO_ORBIT, FlightMode.CIRCLE),
        (mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, FlightMode.RETURN),
        (mav.MAV_CMD_NAV_LAND, FlightMode.SURFACE),
        (mav.MAV_CMD_MISSION_START, FlightMode.MISSION),
    ],
)
def test_what_is_being_carried_out_can_be_cancelled(command: int, mode: FlightMode) -> None:
    world = World()
    client = world.client()
    cancel = extra.MAVLink_command_cancel_message(1, 1, command)
    world.show(armed=True, mode=mode, intended_mode=mode)
    (ack,) = client.ask(cancel, "COMMAND_ACK", 0.1)
    assert (ack.command, ack.result) == (command, CommandResult.CANCELLED) and world.vehicle.calls == [("pause",)]
    world.vehicle.calls.clear()
    for there in (FlightMode.HOLD, FlightMode.MANUAL):
        client.rx.clear()
        world.show(armed=True, mode=there, intended_mode=there)
        client.send(cancel)
        world.run(0.1)
        assert not client.got("COMMAND_ACK") and not world.vehicle.calls, "what is over is not cancelled"


def test_a_restart_is_for_a_disarmed_vehicle_and_asked_for_once(world: World, client: Client) -> None:
    for action, end in ((1.0, RunEnd.AGAIN), (2.0, RunEnd.STOP)):
        client.ask(mav.MAVLink_command_long_message(1, 1, 246, 0, action, *(0.0,) * 6), "COMMAND_ACK", 0.1)
        assert world.vehicle.calls == [("end_run", end)]
        world.vehicle.calls.clear()
    (ack,) = client.ask(mav.MAVLink_command_long_message(1, 1, 246, 0, 3.0, *(0.0,) * 6), "COMMAND_ACK", 0.1)[-1:]
    assert ack.result == mav.MAV_RESULT_DENIED and not world.vehicle.calls


def test_parameters_go_back_to_their_defaults_on_the_ground_only(world: World, client: Client) -> None:
    world.params.set("SPD_CRUISE", 0.2)
    world.params.set("FS_SOLVER_N", 12)
    reset = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_PREFLIGHT_STORAGE, 0, 2.0, -1.0, -1.0, 0, 0, 0, 0)
    world.show(armed=True)
    assert client.ask(reset, "COMMAND_ACK", 0.1)[-1].result == mav.MAV_RESULT_DENIED
    assert world.params["SPD_CRUISE"] == 0.2 and "disarm first" in client.texts()
    world.show(armed=False)
    client.rx.clear()
    world.run(11.0)
    assert client.ask(reset, "COMMAND_ACK", 0.1)[-1].result == mav.MAV_RESULT_ACCEPTED
    assert all(world.params[spec.name] == spec.default for spec in PARAMETERS)
    assert {told.param_id for told in client.got("PARAM_VALUE")} >= {"SPD_CRUISE", "FS_SOLVER_N"}


def test_the_actions_for_ground_stations_without_buttons_work_as_they_are_sent() -> None:
    """COMMAND_LONG, what is not given is 0."""
    file = json.loads((Path(__file__).parents[2] / "docs" / "examples" / "qgc-actions.json").read_text())
    assert (file["fileType"], file["version"]) == ("MavlinkActions", 1)
    for action in file["actions"]:
        world = World("generic")
        world.show(armed=action["mavCmd"] != mav.MAV_CMD_RUN_PREARM_CHECKS)
        client = world.client()
        params = [float(action.get(f"param{n}", 0.0)) for n in range(1, 8)]
        (ack,) = client.ask(mav.MAVLink_command_long_message(1, 1, action["mavCmd"], 0, *params), "COMMAND_ACK", 0.1)
        assert ack.result == mav.MAV_RESULT_ACCEPTED, action
        assert world.vehicle.calls or action["mavCmd"] == mav.MAV_CMD_RUN_PREARM_CHECKS


def test_calibration_says_where_it_is_done() -> None:
    client = World().client()
    gyro = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_PREFLIGHT_CALIBRATION, 0, 1.0, *(0.0,) * 6)
    assert client.ask(gyro, "COMMAND_ACK", 0.1)[-1].result == mav.MAV_RESULT_DENIED
    assert "autopilot calibrate" in client.texts()
    nothing = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_PREFLIGHT_CALIBRATION, 0, *(0.0,) * 7)
    assert client.ask(nothing, "COMMAND_ACK", 0.1)[-1].result == mav.MAV_RESULT_ACCEPTED


@pytest.mark.parametrize("result", [CommandResult.ACCEPTED, CommandResult.FAILED])
@pytest.mark.parametrize("ticks", [5, 60, 250])
def test_a_disarming_is_answered_when_it_has_happened(world: World, ticks: int, result: CommandResult) -> None:
    client, waiting = world.client(sysid=77, compid=88), CommandReply(result=CommandResult.IN_PROGRESS)
    world.vehicle.answers.update(disarm=waiting, disarmed=waiting)
    world.run(0.02)
    client.send(message(mav.MAV_CMD_COMPONENT_ARM_DISARM, [0.0, 0.0, 0.0, 0.0], (1, 1), None, 0))
    world.run(0.01 * ticks)
    results = [ack.result for ack in client.got("COMMAND_ACK")]
    assert results == [5] * (0 if ticks < 30 else 1 + (ticks - 31) // 100)
    client.send(message(mav.MAV_CMD_COMPONENT_ARM_DISARM, [0.0, 0.0, 0.0, 0.0], (1, 1), None, 1))
    world.run(0.02)
    assert [ack.result for ack in client.got("COMMAND_ACK")][len(results) :] == [5]  # asked again: still under way
    reason = "" if result is CommandResult.ACCEPTED else "not confirmed"
    world.vehicle.answers["disarmed"] = CommandReply(result=result, reason=reason)
    world.run(0.05)
    final = [ack for ack in client.got("COMMAND_ACK") if ack.result != 5]
    assert [(ack.result, ack.target_system, ack.target_component) for ack in final] == [(result, 77, 88)]
    client.send(message(mav.MAV_CMD_COMPONENT_ARM_DISARM, [0.0, 0.0, 0.0, 0.0], (1, 1), None, 2))
    world.run(0.05)
    assert client.got("COMMAND_ACK")[-1].result == result  # a repetition gets the final answer
    assert len([call for call in world.vehicle.calls if call[0] == "disarm"]) == 1
