"""Something inside the service fails: the real service on the simulated vehicle, with one part broken on purpose."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from pymavlink.dialects.v20 import development as mav

from autopilot.cli.log import log
from autopilot.control.nmpc.solver import NativeStep, QpStep
from autopilot.core.errors import DriverError
from autopilot.core.messages import Failsafe, Fallback, Outputs
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.estimator.frame_filter import FrameFilter
from autopilot.estimator.vision import Hint
from autopilot.estimator.vision_worker import VisionWorker
from autopilot.log.packer import MAX_PROGRAMS
from autopilot.log.reader import open_log
from autopilot.run.sitl_session import SitlSession
from tests.system.system_harness import sessions
from tests.system.wire_client import Harbour, WireClient

NEUTRAL_US = 1500


class Flight(Harbour):
    """A vehicle that has been armed and is on its mission."""

    def __init__(self, session: SitlSession, client: WireClient) -> None:
        super().__init__(session)
        self.client = client
        self.outputs: list[Outputs] = []

    def tick(self) -> Outputs:
        self.outputs.append(super().tick())
        return self.outputs[-1]

    def fly(self, seconds: float) -> list[Outputs]:
        begin = len(self.outputs)
        self.run(seconds)
        return self.outputs[begin:]

    def order(self, command: int, *params: float) -> None:
        """Waits for no answer."""
        self.client.send(mav.MAVLink_command_long_message(1, 1, command, 0, *(*params, *(0.0,) * 7)[:7]))

    def texts(self) -> list[str]:
        return self.client.texts(least=mav.MAV_SEVERITY_DEBUG)

    def beats(self) -> int:
        return len(self.client.received("HEARTBEAT"))


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[Callable[..., Flight]]:
    """Makes flights that are on their way, with the guard as in production."""
    with sessions(tmp_path) as session:

        def make(log: Path | None = None) -> Flight:
            client, params = WireClient(), {"FS_FAULT_TIME": 2.0, "MPC_COST": 0.0}
            made = Flight(session(sensors="pose", start=True, params=params, log=log, peers=(client,)), client)
            made.session.parts.guard.raises = made.session.runtime._guard.raises = False
            made.fly(3.5)
            assert made.outputs[-1].mode.armed
            return made

        yield make


@pytest.fixture(name="made")
def made_fixture(flight: Callable[..., Flight]) -> Flight:
    return flight()


def broken(*_: object, **__: object) -> Any:
    """Stands where a part of the service was."""
    raise ZeroDivisionError("broken on purpose")


def at_rest(outputs: Outputs) -> bool:
    return set(outputs.command.pwm_us[:4]) == {NEUTRAL_US}


def test_a_controller_that_fails_is_replaced_by_station_keeping_then_by_neutral(made: Flight) -> None:
    made.session.parts.controller.step = broken  # type: ignore[method-assign]
    here = made.session.device.truth.pos_ned_m.copy()
    held = made.fly(1.8)
    assert all(tick.mode.armed for tick in held)
    assert np.linalg.norm(made.session.device.truth.pos_ned_m - here) < 0.5
    assert sum(not at_rest(tick) for tick in held) > 100
    last = held[-1]
    assert last.mode.failsafes >> Failsafe.FAULT & 1
    rest = made.fly(2.0)
    assert all(at_rest(tick) for tick in rest[60:])
    assert all(tick.mode.armed for tick in rest)
    assert made.texts().count("Internal fault: controller: ZeroDivisionError") == 1
    assert made.beats() >= 9


def test_the_operator_tries_again_and_the_second_fault_disarms(made: Flight) -> None:
    sound = made.session.parts.controller.step
    made.session.parts.controller.step = broken  # type: ignore[method-assign]
    made.fly(0.5)
    made.session.parts.controller.step = sound  # type: ignore[method-assign]
    made.order(mav.MAV_CMD_MISSION_START)
    again = made.fly(1.0)
    assert again[-1].control is not None or any(tick.control is not None for tick in again[-5:])
    assert not any(tick.faults for tick in again)
    made.session.parts.controller.step = broken  # type: ignore[method-assign]
    stopped = made.fly(0.3)
    assert not stopped[-1].mode.armed
    assert all(at_rest(tick) for tick in stopped[6:])
    assert any("failed twice" in text for text in made.texts())


@pytest.mark.parametrize("part", ["estimator", "commander", "allocation"])
def test_a_part_that_goes_on_failing_disarms_and_the_rest_goes_on(made: Flight, part: str) -> None:
    parts, beats = made.session.parts, made.beats()
    method = {"estimator": "step", "commander": "step", "allocation": "pulses_us"}[part]
    target = parts.actuation.allocation if part == "allocation" else getattr(parts, part)
    sound = getattr(target, method)
    setattr(target, method, broken)
    after = made.fly(2.5)
    assert not after[-1].mode.armed
    assert all(at_rest(tick) for tick in after[10:])
    assert made.beats() >= beats + 2
    assert any(part in text for text in made.texts())
    if part != "estimator":
        assert after[-1].nav is not None and after[-1].nav.t_us == made.outputs[-1].t_us
    setattr(target, method, sound)
    made.order(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    assert not made.fly(0.1)[-1].mode.armed
    assert any("Arming denied" in text and "internal fault" in text for text in made.texts())


def test_a_message_that_cannot_be_handled_is_answered_and_nothing_else_happens(made: Flight) -> None:
    made.session.parts.commander.change_speed = broken  # type: ignore[method-assign]
    for _ in range(3):
        made.order(mav.MAV_CMD_DO_CHANGE_SPEED, 1.0, 0.2)
        made.fly(0.3)
    acks = [m.result for m in made.client.inbox if m.get_type() == "COMMAND_ACK" and m.command == 178]
    assert acks == [mav.MAV_RESULT_FAILED] * 3
    assert made.outputs[-1].mode.armed
    assert made.outputs[-1].control is not None or any(tick.control is not None for tick in made.outputs[-5:])
    assert any("message" in text for text in made.texts())


def test_telemetry_that_cannot_be_built_costs_that_message(made: Flight) -> None:
    streams = made.session.parts.server._streams
    streams._builders = {**streams._builders, mav.MAVLINK_MSG_ID_VFR_HUD: broken}
    made.client.inbox.clear()
    made.fly(2.2)
    kinds = {m.get_type() for m in made.client.inbox}
    assert "VFR_HUD" not in kinds
    assert {"HEARTBEAT", "ATTITUDE", "SYS_STATUS", "ESTIMATOR_STATUS", "BATTERY_STATUS"} <= kinds
    assert made.outputs[-1].mode.armed


def test_what_no_part_catches_ends_in_neutral(made: Flight) -> None:
    made.session.service._outputs = broken  # type: ignore[method-assign]
    after = made.fly(1.5)
    assert all(at_rest(tick) for tick in after)
    assert not after[-1].mode.armed


def test_a_fault_is_in_the_log_with_its_inputs(flight: Callable[..., Flight], tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    made = flight(log=path)
    made.session.parts.controller.step = broken  # type: ignore[method-assign]
    made.fly(0.3)
    made.session.recorder.close()
    rows = open_log(path).messages("/rosout")
    assert any("broken on purpose" in str(text) and "test_guard.py" in str(text) for text in rows)
    attached = {name: data for name, data in open_log(path).attachments.items() if name.startswith("fault-")}
    assert list(attached) == ["fault-01.txt"]
    text = attached["fault-01.txt"].decode()
    assert "Traceback" in text and "NavState(" in text and "goal=Goal(" in text


def test_a_guard_that_is_set_to_raise_raises(made: Flight, flight: Callable[..., Flight]) -> None:
    made.session.parts.guard.raises = True
    made.session.parts.controller.step = broken  # type: ignore[method-assign]
    with pytest.raises(ZeroDivisionError):
        made.fly(0.1)


# Devices


class Unplugged:
    """A device between runtime and vehicle of which some calls fail for a while."""

    def __init__(self, flight: Flight, **failing: Exception) -> None:
        self._inner, self.failing = flight.session.device, failing
        self.written: list[tuple[int, ...]] = []
        flight.session.runtime._device = self  # type: ignore[assignment]

    def __getattr__(self, name: str) -> Any:
        if name in self.failing:

            def fail(*_: object) -> Any:
                raise self.failing[name]

            return fail
        return getattr(self._inner, name)


@pytest.mark.parametrize(
    "error", [DriverError("serial line is gone; check the cable"), OSError(5, "Input/output error")]
)
def test_sensors_that_disappear_are_said_and_come_back(made: Flight, error: Exception) -> None:
    device = Unplugged(made, poll=error)
    made.client.inbox.clear()
    after = made.fly(1.5)
    assert after[-1].mode.failsafes >> Failsafe.AHRS_STALE & 1
    texts = made.texts()
    assert sum(text.startswith("Sensors failed") for text in texts) == 1
    assert made.beats() >= 1
    device.failing.clear()
    made.fly(2.0)
    assert "Sensors: working again" in made.texts()
    assert made.outputs[-1].nav is not None and made.outputs[-1].nav.t_us == made.outputs[-1].t_us


def test_one_failed_thruster_write_is_said_and_the_next_succeeds(made: Flight) -> None:
    device = Unplugged(made, write=DriverError("thruster output failed: no answer; check cable and power"))
    made.fly(0.02)
    device.failing.clear()
    after = made.fly(1.0)
    assert all(tick.mode.armed for tick in after)
    assert sum(text.startswith("Thrusters failed") for text in made.texts()) == 1
    assert not any(tick.mode.failsafes >> Failsafe.THRUSTER & 1 for tick in after)


def test_a_thruster_output_that_stays_away_is_a_failsafe(made: Flight) -> None:
    Unplugged(made, write=OSError(5, "Input/output error"))
    after = made.fly(3.5)
    assert after[-1].mode.failsafes >> Failsafe.THRUSTER & 1


def test_after_a_failed_write_neutral_is_tried(made: Flight) -> None:
    written: list[tuple[int, ...]] = []
    inner = made.session.device.write

    def first_fails(t_us: int, command: Any) -> None:
        written.append(command.pwm_us)
        if len(written) == 1:
            raise DriverError("no answer")
        inner(t_us, command)

    made.session.device.write = first_fails  # type: ignore[method-assign]
    made.fly(0.02)
    assert set(written[1][:4]) == {NEUTRAL_US}
    assert len(written) == 3


class Blind:
    """A detector that fails at its pictures."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
        raise self._error


@pytest.mark.parametrize("error", [cv2.error("bad picture"), ValueError("a bug")])
def test_a_picture_that_detection_fails_at_is_no_sighting(error: Exception) -> None:
    worker = VisionWorker(Blind(error), delay_s=0.05, frame_filter=FrameFilter(64, 48))
    worker.guard.raises = False
    picture = np.random.default_rng(1).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    worker.submit(10_000, CameraFrame(t_us=10_000, image_bgr=picture), None)
    assert worker.collect(100_000) == []
    assert worker.counters()["frames.failed"] == 1
    faults = worker.guard.take()
    assert [fault.kind for fault in faults] == ([] if isinstance(error, cv2.error) else ["ValueError"])
    worker.close()


def test_what_the_optimiser_fails_to_solve_is_told_saved_and_solved_again(
    flight: Callable[..., Flight], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A solver that returns nonsense for 0.2 s: two words to the operator, and the programs in the log."""
    path = tmp_path / "run.mcap"
    made = flight(log=path)
    made.fly(1.0)
    with monkeypatch.context() as patch:
        for kind in (QpStep, NativeStep):
            patch.setattr(kind, "evaluate", lambda step: step.figures.fill(1.0))
        during = made.fly(0.2)
    after = made.fly(1.5)
    assert {tick.control.status.fallback for tick in during[5:] if tick.control} == {Fallback.SHIFTED_PLAN}
    assert {tick.control.status.fallback for tick in after[10:] if tick.control} == {Fallback.NONE}
    texts = [text for text in made.texts() if text.startswith("Controller")]
    assert texts == ["Controller: no solution, last plan goes on", "Controller has solutions again"]
    made.session.recorder.close()
    asked = [program for tick in during if tick.control for program in tick.control.unsolved]
    result = CliRunner().invoke(log, ["programs", str(path), "--json"])
    assert result.exit_code == 1, "there is something"
    listed = json.loads(result.stdout)["programs"]
    assert len(listed) == min(len(asked), MAX_PROGRAMS) > 5
    assert [entry["t_s"] for entry in listed] == pytest.approx([one.t_us * 1e-6 for one in asked[: len(listed)]])
    for entry in listed:
        assert entry["status"] == "RESIDUAL"
        again = [trial for trial in entry["again"] if trial["status"] is not None]
        assert len(again) >= 2
        assert {trial["status"] for trial in again} == {"OK"}
        thrusts = np.array([trial["thrust_n"] for trial in again])
        assert np.abs(thrusts - thrusts[0]).max() < 0.3
    shown = CliRunner().invoke(log, ["programs", str(path)])
    assert "RESIDUAL" in shown.stdout
