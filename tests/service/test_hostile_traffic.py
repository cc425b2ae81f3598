"""Hostile messages and samples into the real service: the short form of ``autopilot bench fuzz``, and what it found."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mav
from service_world import ServiceWorld

from autopilot.core.params import PARAMETERS
from autopilot.core.stills import CameraReport
from autopilot.mavlink.camera_component import REQUESTS
from tests.bench.fuzz.fuzzer import Fuzzer, Mood
from tests.bench.fuzz.message_observer import BrokenRuleError
from tests.bench.fuzz.messages import (
    ALL_COMMANDS,
    CAMERA_COMMANDS,
    COMMANDS,
    EQUIPMENT_COMMANDS,
    HANDLED,
    KNOWN_COMMANDS,
    ODD_FLOATS,
)
from tests.bench.fuzz.run import run_fuzz

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fuzzer]:
    made = Fuzzer(11, tmp_path_factory.mktemp("fuzz"))
    yield made
    made.close()


def test_the_fuzzer_knows_every_message_that_is_handled(fuzzer: Fuzzer) -> None:
    inside = fuzzer.session.parts.server
    assert set(inside._handlers) == set(HANDLED)
    assert set(inside._commands.table) == {*COMMANDS, *EQUIPMENT_COMMANDS}
    pictured = WORLD.parts.server
    assert set(pictured._commands.table) == {*COMMANDS, *EQUIPMENT_COMMANDS, *CAMERA_COMMANDS} - REQUESTS
    assert pictured._to_camera is not None
    assert set(pictured._to_camera.table) == {*CAMERA_COMMANDS, 204, 205, 512, 1000, 1001}


def test_a_few_minutes_of_everything(fuzzer: Fuzzer) -> None:
    for _ in range(7):
        fuzzer.episode(150, Mood.ANYTHING)
    result = fuzzer.result
    assert result.messages > 2000
    assert result.armed_ticks > 100
    assert min(result.accepted[f"command {how}"] for how in ("accepted", "refused")) > 10
    assert result.accepted["plan refused"] > 10 and result.accepted["plan accepted"] > 0
    assert min(result.handled["MAVLink 1"], result.handled["MAVLink 2"]) > 100


def test_strangers_and_sticks_and_a_key(tmp_path: Path) -> None:
    """Who is not in control changes nothing, sticks and orders end inside the fence, only what is signed is heard."""
    fuzzer = Fuzzer(12, tmp_path, signed=True)
    try:
        assert fuzzer.episode(120, Mood.STRANGERS) and fuzzer.episode(400, Mood.STEERING)
        result = fuzzer.result
        assert result.handled["signed"] > 200 and result.handled["MAVLink 2"] == result.handled["MAVLink 1"] == 0
        assert 0.0 < result.least_m < 1.0
    finally:
        fuzzer.close()


def test_logs_of_whoever_runs_the_fuzzer_are_not_its_clients_to_erase(fuzzer: Fuzzer, tmp_path: Path) -> None:
    """It had the folder of the user's own flights on its shelf, and LOG_ERASE among its messages."""
    logs = fuzzer.session.parts.server._logs._log_directory
    assert logs.log_directory._folder.is_relative_to(tmp_path.parent)


def test_the_fuzzer_finds_what_is_broken(fuzzer: Fuzzer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Guards the others: an exception, and thrust without arming, are findings."""
    with monkeypatch.context() as patch, pytest.raises(BrokenRuleError, match="disarmed"):
        patch.setattr(fuzzer, "_neutral", (0,) * 4)
        for _ in range(3):
            fuzzer._calm()
    for _ in range(3):
        fuzzer._calm()  # what is left of floods before is worked off
    monkeypatch.setattr(fuzzer.session.parts.commander, "change_speed", lambda speed: 1 / 0)
    command = mav.MAVLink_command_long_message(1, 1, 178, 0, 1.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(ZeroDivisionError):
        fuzzer.step([bytes(command.pack(mav.MAVLink(None, srcSystem=9, srcComponent=1)))], wild=False)


def test_the_same_seed_is_the_same_traffic_and_as_much_as_asked_for() -> None:
    runs = [run_fuzz(1500, seed=5) for _ in range(2)]
    assert 1500 <= runs[0].messages < 1550
    assert runs[0].accepted == runs[1].accepted and runs[0].handled == runs[1].handled
    assert runs[0].failures == runs[1].failures == []


class PicturedWorld(ServiceWorld):
    """With a camera that takes any still and never delivers one."""

    pictures = True

    def camera(self) -> dict[str, Any]:
        return {"camera": CameraReport(frame_us=0, total_bytes=10**9, free_bytes=10**8)}


WORLD = PicturedWorld()
WORLD.run(2.0)
numbers = st.sampled_from(ODD_FLOATS) | st.floats(width=32)
whole32 = st.sampled_from((0, 1, -1, 2**31 - 1, -(2**31))) | st.integers(-(2**31), 2**31 - 1)


def _digest(world: ServiceWorld) -> tuple[object, ...]:
    plans = world.parts.plans
    armed, mode = world.parts.commander.armed, world.parts.commander.intended_mode
    return tuple(world.params.values()), plans.home_ned_m.tolist(), plans.origin, armed, mode


@given(
    command=st.sampled_from(KNOWN_COMMANDS) | st.sampled_from(ALL_COMMANDS),
    params=st.lists(numbers, min_size=4, max_size=4),
    frame=st.sampled_from((0, 1, 2, 3, 5, 6, 20, 255)),
    place=st.tuples(whole32, whole32, numbers),
)
@settings(max_examples=300)
def test_any_command_is_answered_and_a_refused_one_changes_nothing(
    command: int, params: list[float], frame: int, place: tuple[int, int, float]
) -> None:
    before = _digest(WORLD)
    WORLD.inbox.clear()
    WORLD.tick([WORLD.pack(mav.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *params, *place))])
    acks = [m for m in WORLD.inbox if m.get_type() == "COMMAND_ACK"]
    assert [ack.command for ack in acks] == [command]
    if acks[0].result != mav.MAV_RESULT_ACCEPTED:
        assert _digest(WORLD) == before


@given(spec=st.sampled_from(PARAMETERS), where=st.floats(-0.2, 1.2))
@settings(max_examples=200)
def test_parameters_in_their_whole_range(spec: object, where: float) -> None:
    low, high = spec.minimum, spec.maximum  # type: ignore[attr-defined]
    value = low + where * (high - low)
    WORLD.tick([WORLD.pack(mav.MAVLink_param_set_message(1, 1, spec.name.encode(), value, 9))])  # type: ignore[attr-defined]
    WORLD.run(0.05)
    assert all(s.minimum <= WORLD.params[s.name] <= s.maximum for s in PARAMETERS)
    WORLD.params.set(spec.name, spec.default)  # type: ignore[attr-defined]


# Found by the fuzzer
