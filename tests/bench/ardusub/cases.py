"""What happens between the service, ArduSub and its pilot; each case says what it saw, or fails."""

import signal
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from autopilot.run.children import LOCAL
from tests.bench.ardusub.rig import (
    ARM,
    DEPTH_HOLD,
    FORCE,
    LEAK_BIT,
    MANUAL,
    MISSION_START,
    READY_S,
    REBOOT,
    STABILIZE,
    SURFACE,
    Below,
    Rig,
)

LAP_S = 400.0
"""Patience for a mission of 30 s in the tank, 150 s in the pool."""
NEUTRAL_S = 0.6
"""FS_PILOT_TIMEOUT 0.4, and reports at 20 ms on a computer that is shared."""
TAKEOVER_S = 0.5
RIVAL_EVERY_S, RIVAL_TURNS, RIVAL_TOLD_S = 0.041, 100, 3.0
"""A joystick of 25 Hz with a sloppy timer. What stands only until our next command is read (up to 20 ms of its 41) is
in half of the reports at the worst phase, in none at the best: within a second its phase goes through all of ours."""
SET_SERVO, LIGHTS = 183, 13
EVEN_ARMED = 20_190_226.0
"""Of ArduPilot's reboot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """Makes rigs for one case after the other."""

    folder: Path
    below: Below
    made: list[Rig] = field(default_factory=list)

    def rig(self, *arguments: object, **given: object) -> Rig:
        rig = Rig(self.folder / str(len(self.made)), self.below, *arguments, **given)  # type: ignore[arg-type]
        self.made.append(rig)
        return rig


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    name: str
    wanted: str
    run: Callable[[Bench], str]
    real_only: bool = False
    """Of ArduSub's own, which the emulator does not do."""


CASES: list[Case] = []


def case(name: str, wanted: str, *, real_only: bool = False) -> Callable[[Callable[[Bench], str]], None]:
    def add(run: Callable[[Bench], str]) -> None:
        CASES.append(Case(name=name, wanted=wanted, run=run, real_only=real_only))

    return add


def must(holds: bool, seen: str) -> None:
    if not holds:
        raise AssertionError(seen)


def below(seen_s: float, most_s: float, what: str) -> str:
    must(seen_s < most_s, f"{what} {seen_s:.2f} s, more than {most_s:g} s")
    return f"{what} {seen_s:.2f} s"


# Missions


def _lap(bench: Bench, frame: str) -> str:
    with bench.rig(frame) as rig:
        rig.upload()
        rig.until_ready()
        rig.arm()
        begin_s = time.monotonic()
        must(rig.operator.command(MISSION_START) == 0, "the mission does not start")
        ends = ("Mission complete", "Failsafe HOLD", "Failsafe SURFACE")
        _, end = rig.operator.wait("STATUSTEXT", lambda m: m.text.startswith(ends), LAP_S)
        took_s = time.monotonic() - begin_s
        must(end.text.startswith("Mission complete"), end.text)
        contacts = rig.end()
    must(contacts == 0, f"{contacts} contacts")
    overruns = next((line for line in rig.said.splitlines() if "overruns" in line), "no overruns")
    return f"{took_s:.0f} s, 0 contacts, {overruns.split(', ', 1)[-1]}"


@case("mission, vectored", "complete, no contact")
def _(bench: Bench) -> str:
    return _lap(bench, "vectored")


@case("mission, vectored_6dof", "complete, no contact")
def _(bench: Bench) -> str:
    return _lap(bench, "vectored_6dof")


# The pilot


@case("pilot chooses STABILIZE, then MANUAL", "autopilot silent, told; then HOLD")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        seen = _taken_over(rig, STABILIZE)
        mark = rig.operator.mark
        rig.mode_of_pilot(MANUAL)
        rig.operator.text("Pilot returned control", mark=mark)
        return f"{seen}; given back"


def _taken_over(rig: Rig, mode: int) -> str:
    mark, begin_s = rig.operator.mark, time.monotonic()
    rig.mode_of_pilot(mode)
    told_s, _ = rig.operator.text("Pilot has control", mark=mark)
    return below(told_s - begin_s, TAKEOVER_S, "told after")


@case("pilot chooses ALT_HOLD, PILOT_BACK 1", "after MANUAL the mission goes on")
def _(bench: Bench) -> str:
    with bench.rig(ours=["PILOT_BACK=1"]) as rig:
        rig.fly()
        seen = _taken_over(rig, DEPTH_HOLD)
        time.sleep(2.0)
        mark = rig.operator.mark
        rig.mode_of_pilot(MANUAL)
        rig.operator.text("Pilot returned control", mark=mark)
        rig.operator.wait("MISSION_ITEM_REACHED", lambda m: True, LAP_S, mark)
        return f"{seen}; next item reached"


@case("pilot disarms", "the autopilot disarms too and says so")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark, begin_s = rig.operator.mark, time.monotonic()
        rig.pilot.command(ARM, 0.0, FORCE)
        told_s, _ = rig.operator.text("Flight controller disarmed", mark=mark)
        rig.until_disarmed()
        return below(told_s - begin_s, 3.0, "told after")


def _rivalled(bench: Bench, name: str, *fields: int) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark, begin_s = rig.operator.mark, time.monotonic()
        for _turn in range(RIVAL_TURNS):
            rig.pilot.say(name, *fields)
            time.sleep(RIVAL_EVERY_S)
        told_s, _ = rig.operator.text("another sender", mark=mark)
        return below(told_s - begin_s, RIVAL_TOLD_S, "told after")


@case("second sender: joystick (MANUAL_CONTROL)", "failsafe SENDER, hold")
def _(bench: Bench) -> str:
    return _rivalled(bench, "manual_control", 1, 700, 0, 500, 0, 0)


@case("second sender: RC_CHANNELS_OVERRIDE", "failsafe SENDER, hold")
def _(bench: Bench) -> str:
    return _rivalled(bench, "rc_channels_override", 1, 1, 1500, 1500, 1500, 1700, 1500, 1500, 65535, 65535)


@case("radio receiver sends, RC_PROTOCOLS 0", "no effect on the flight", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark = rig.operator.mark
        port = 5501 + 10 * rig.instance
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            for _turn in range(150):
                radio.sendto(struct.pack("<8H", 1500, 1500, 1500, 1800, 1800, 1500, 1500, 1500), (LOCAL, port))
                time.sleep(0.02)
        texts = [m.text for _, m in rig.operator.since(mark, "STATUSTEXT") if m.severity <= 4]
        must(not texts, f"{texts}")
        rig.operator.wait("MISSION_ITEM_REACHED", lambda m: True, LAP_S, mark)
        return "next item reached, no warning"


# The service


@case("service killed", "neutral after FS_PILOT_TIMEOUT 0.4 s; stays armed")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        return _killed(rig)


def _killed(rig: Rig) -> str:
    assert rig.service is not None
    mark, begin_s = rig.pilot.mark, time.monotonic()
    rig.service.kill()
    seen = below(rig.neutral_s(mark, begin_s), NEUTRAL_S, "neutral after")
    must(rig.is_armed(), "it disarmed by itself")
    return seen


@case("service started again after a kill", "found ARMED; DISARM disarms ArduSub")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        _killed(rig)
        mark = rig.operator.mark
        rig.start_service()
        rig.operator.text("found ARMED", READY_S, mark)
        rig.operator.command(ARM, 0.0)
        rig.below_until(armed=False)
        rig.until_ready()
        rig.arm()
        return "found armed, disarmed, armed again"


@case("service ended (SIGTERM) under way", "neutral, ArduSub disarmed")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        assert rig.service is not None
        mark, begin_s = rig.pilot.mark, time.monotonic()
        rig.service.terminate()
        seen = below(rig.neutral_s(mark, begin_s), NEUTRAL_S, "neutral after")
        rig.below_until(armed=False)
        return f"{seen}, disarmed"


@case("service frozen for 3 s (SIGSTOP)", "neutral after 0.4 s; then goes on or says why not")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        assert rig.service is not None
        mark, begin_s = rig.pilot.mark, time.monotonic()
        rig.service.send_signal(signal.SIGSTOP)
        seen = below(rig.neutral_s(mark, begin_s), NEUTRAL_S, "neutral after")
        time.sleep(3.0 - (time.monotonic() - begin_s))
        mark = rig.operator.mark
        rig.service.send_signal(signal.SIGCONT)
        rig.operator.wait("HEARTBEAT", lambda m: m.get_srcComponent() == 1, 20.0, mark)
        time.sleep(5.0)
        texts = [m.text for _, m in rig.operator.since(mark, "STATUSTEXT") if m.severity <= 4]
        must(rig.turning or bool(texts), "stands still without a word")
        return f"{seen}; then {'under way' if rig.turning else texts[0]}"


@case("operator kills (disarm by force)", "ArduSub disarmed, thrusters neutral")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark, begin_s = rig.pilot.mark, time.monotonic()
        must(rig.operator.command(ARM, 0.0, FORCE) == 0, "refused")
        neutral_s = rig.neutral_s(mark, begin_s)
        rig.below_until(armed=False, mark=mark)
        return below(neutral_s, 0.3, "neutral after")


@case("operator's link lost, FS_GCS_ENABLE 3", "HOLD after 5 s, then on with the mission by the operator")
def _(bench: Bench) -> str:
    with bench.rig(ours=["FS_GCS_ENABLE=3"]) as rig:
        rig.fly()
        mark, rig.operator.beating = rig.operator.mark, False
        begin_s = time.monotonic()
        told_s, _ = rig.operator.text("Failsafe HOLD: ground station lost", mark=mark)
        rig.operator.beating = True
        must(rig.is_armed(), "ArduSub disarmed")
        rig.operator.text("Failsafe over: ground station lost", mark=mark)
        must(rig.operator.command(MISSION_START) == 0, "the mission does not go on")
        rig.operator.wait("MISSION_ITEM_REACHED", lambda m: True, LAP_S)
        return f"HOLD after {told_s - begin_s:.1f} s, then next item reached"


# The flight controller


@case("ArduSub reboots under way", "disarmed, told; parameters read again; arms again", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark, begin_s = rig.operator.mark, time.monotonic()
        rig.pilot.say("command_long", 1, 1, REBOOT, 0, 1.0, *(0.0,) * 4, EVEN_ARMED, 0.0)
        told_s, text = rig.operator.text("Flight controller disarmed", READY_S, mark)
        time.sleep(5.0)
        rig.until_ready()
        rig.arm()
        return f"{text} after {told_s - begin_s:.1f} s; armed again"


@case("cable to ArduSub out for 8 s (its process stands still)", "told, no thrust; then disarmed or usable")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        stopped = rig.water if rig.ardusub is None else rig.ardusub
        mark, begin_s = rig.operator.mark, time.monotonic()
        stopped.send_signal(signal.SIGSTOP)
        told_s, text = rig.operator.text("Failsafe", READY_S, mark)
        time.sleep(max(0.0, 8.0 - (time.monotonic() - begin_s)))
        mark = rig.operator.mark
        stopped.send_signal(signal.SIGCONT)
        time.sleep(4.0)
        rig.operator.command(ARM, 0.0, FORCE)
        rig.below_until(armed=False)
        rig.until_ready()
        rig.arm()
        return f"{text} after {told_s - begin_s:.1f} s; disarmed, armed again"


@case("ArduSub stands still for 1 s: its clock is late", "goes on, or surfaces and says why; no reset of the position")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        stopped = rig.water if rig.ardusub is None else rig.ardusub
        mark = rig.operator.mark
        stopped.send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        stopped.send_signal(signal.SIGCONT)
        time.sleep(8.0)
        texts = [m.text for _, m in rig.operator.since(mark, "STATUSTEXT") if m.severity <= 5]
        must(not any("reset" in text for text in texts), f"{texts}")
        must(rig.is_armed() or "Surfaced" in rig.said, f"disarmed: {texts}")
        return texts[0] if texts else "goes on"


@case("leak, FS_LEAK_ENABLE 2 of the autopilot", "failsafe LEAK, SURFACE", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig(parameters={"FS_LEAK_ENABLE": 1.0}) as rig:
        rig.fly()
        mark, begin_s = rig.operator.mark, time.monotonic()
        rig.pilot.set_parameter("SIM_PIN_MASK", LEAK_BIT)
        told_s, _ = rig.operator.text("Failsafe SURFACE: water in the hull", mark=mark)
        return below(told_s - begin_s, 10.0, "SURFACE after")


@case("leak, FS_LEAK_ENABLE 2 of ArduSub", "ArduSub surfaces by itself: the autopilot makes way", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig(parameters={"FS_LEAK_ENABLE": 2.0}) as rig:
        rig.fly()
        mark, heard = rig.operator.mark, rig.pilot.mark
        rig.pilot.set_parameter("SIM_PIN_MASK", LEAK_BIT)
        _, text = rig.operator.text("Pilot has control", mark=mark)
        rig.pilot.wait("HEARTBEAT", lambda m: m.get_srcComponent() == 1 and m.custom_mode == SURFACE, 20.0, heard)
        return text


@case("low battery, BATT_FS_LOW_ACT disarms", "the autopilot disarms too and says so", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig(parameters={"BATT_MONITOR": 4.0, "BATT_FS_LOW_ACT": 2.0, "BATT_LOW_TIMER": 1.0}) as rig:
        rig.fly()
        mark = rig.operator.mark
        rig.pilot.set_parameter("BATT_LOW_VOLT", 30.0)
        _, text = rig.operator.text("Flight controller disarmed", mark=mark)
        rig.until_disarmed()
        return text


# Before arming


def _refused(rig: Rig, named: str) -> str:
    with rig:
        rig.upload()
        time.sleep(12.0)  # its parameters are read
        mark = rig.operator.mark
        must(rig.operator.command(ARM, 1.0) != 0, "it arms")
        _, text = rig.operator.text(named, mark=mark)
        must(not rig.is_armed(), "ArduSub armed")
        return text


@case("FS_PILOT_TIMEOUT 3", "arming denied, the parameter named")
def _(bench: Bench) -> str:
    return _refused(bench.rig(parameters={"FS_PILOT_TIMEOUT": 3.0}), "FS_PILOT_TIMEOUT")


@case("radio receiver enabled, RC_PROTOCOLS 1", "arming denied, the parameter named")
def _(bench: Bench) -> str:
    return _refused(bench.rig(parameters={"RC_PROTOCOLS": 1.0}), "RC_PROTOCOLS")


@case("the file says vectored_6dof, ArduSub vectored", "arming denied, FRAME_CONFIG named")
def _(bench: Bench) -> str:
    return _refused(bench.rig(file_frame="vectored_6dof"), "FRAME_CONFIG")


@case("ArduSub's own pre-arm check fails", "arming denied in its words", real_only=True)
def _(bench: Bench) -> str:
    return _refused(bench.rig(parameters={"BATT_MONITOR": 4.0, "BATT_ARM_VOLT": 30.0}), "Battery")


@case("lights: DO_SET_SERVO to the autopilot", "output 13 of ArduSub")
def _(bench: Bench) -> str:
    with bench.rig(parameters={"SERVO13_FUNCTION": 0.0}) as rig:
        rig.upload()
        rig.until_ready()
        mark, begin_s = rig.pilot.mark, time.monotonic()
        must(rig.operator.command(SET_SERVO, float(LIGHTS), 1700.0) == 0, "refused")
        t_s, _ = rig.pilot.wait("SERVO_OUTPUT_RAW", lambda m: m.port == 0 and m.servo13_raw == 1700, 10.0, mark)
        return f"1700 us after {t_s - begin_s:.2f} s"
