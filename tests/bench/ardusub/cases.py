"""What happens between the service, ArduSub and its pilot; each case says what it saw, or fails."""

import re
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
from tests.bench.ardusub.swings import swings
from tests.lossy_link import LinkConditions

COMPLETE = "complete, no contact"
WARNING = 4
"""MAV_SEVERITY."""
LAP_S = 600.0
"""Patience for a mission: 30 s in the tank, 280 s in the pool."""
NEUTRAL_S = 0.6
"""FS_PILOT_TIMEOUT 0.4, and reports at 20 ms on a computer that is shared."""
TAKEOVER_S, TOLD_S = 0.5, 3.0
RIVAL_EVERY_S, RIVAL_TURNS, RIVAL_TOLD_S = 0.041, 100, 3.0
"""A joystick of 25 Hz with a sloppy timer. What stands only until our next command is read (up to 20 ms of its 41) is
in half of the reports at the worst phase, in none at the best: within a second its phase goes through all of ours."""
JOYSTICK = (1, 700, 0, 500, 0, 0)
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


def below(rig: Rig, seen_s: float, most_s: float, what: str) -> str:
    rig.figures[f"{what}, s"] = seen_s
    must(seen_s < most_s, f"{what} {seen_s:.2f} s, more than {most_s:g} s")
    return f"{what} {seen_s:.2f} s"


# Missions


def _mission(rig: Rig, *, whole: bool = True) -> str:
    with rig:
        rig.upload()
        rig.until_ready()
        rig.arm()
        mark, begin_s = rig.operator.mark, time.monotonic()
        must(rig.operator.command(MISSION_START) == 0, "the mission does not start")
        ends = ("Mission complete", "Failsafe HOLD", "Failsafe SURFACE")
        _, end = rig.operator.wait("STATUSTEXT", lambda m: m.text.startswith(ends), LAP_S, mark)
        took_s = time.monotonic() - begin_s
        warnings = [m.text for _, m in rig.operator.since(mark, "STATUSTEXT") if m.severity <= WARNING]
        contacts = rig.end()
    complete = end.text.startswith("Mission complete")
    overruns = re.search(r"overruns \(([\d.]+) %", rig.said)
    share = 0.0 if overruns is None else float(overruns[1])
    moved = swings(rig.folder / "truth.jsonl")
    rig.figures |= {
        "overruns, %": share,
        "warnings": float(len(warnings)),
        "pitch rms, rad": moved.pitch_rms_rad,
        "pitch p99, rad": moved.pitch_p99_rad,
        "greatest tilt, rad": moved.tilt_rad,
    }
    if complete:
        rig.figures["mission, s"] = took_s
    must(complete or not whole, end.text)
    must(contacts == 0, f"{contacts} contacts")
    told = "; ".join(dict.fromkeys(warnings))
    seen = f"{took_s:.0f} s, {share:g} % overruns, pitch p99 {moved.pitch_p99_rad:.2f}, tilt {moved.tilt_rad:.2f} rad"
    return f"{seen}; {told}" if told else seen


@case("tank by poses, 3 laps", COMPLETE)
def _(bench: Bench) -> str:
    return _mission(bench.rig(laps=3))


@case("the same without `[levelling]`", "no contact")
def _(bench: Bench) -> str:
    return _mission(bench.rig(laps=3, levelling=False), whole=False)


@case("pool by poses, vectored_6dof", COMPLETE)
def _(bench: Bench) -> str:
    return _mission(bench.rig("vectored_6dof"))


@case("tank by poses, tether of 100 ms, 5 % lost", f"{COMPLETE}, no doubt or reset")
def _(bench: Bench) -> str:
    tether = LinkConditions(latency_s=0.1, loss=0.05)
    seen = _mission(bench.rig(laps=3, tether=tether, ours=["EST_EXT_DELAY=0.1"]))
    must(not re.search("Position reset|another sender|wrong: ", bench.made[-1].said), seen)
    return seen


@case("tank by markers, 3 laps", COMPLETE)
def _(bench: Bench) -> str:
    return _mission(bench.rig(markers=True, laps=3))


@case("pool by markers, 3 laps", COMPLETE)
def _(bench: Bench) -> str:
    return _mission(bench.rig(place="pool", markers=True, laps=3))


# The pilot


@case("pilot: STABILIZE, then MANUAL", "told; HOLD")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        return borrowed(rig, STABILIZE)


def borrowed(rig: Rig, mode: int) -> str:
    seen = taken_over(rig, mode)
    mark = rig.operator.mark
    rig.mode_of_pilot(MANUAL)
    rig.operator.text("Pilot returned control: holding", mark=mark)
    return f"{seen}; holds"


def taken_over(rig: Rig, mode: int) -> str:
    mark, begin_s = rig.operator.mark, time.monotonic()
    rig.mode_of_pilot(mode)
    told_s, _ = rig.operator.text("Pilot has control", mark=mark)
    return below(rig, told_s - begin_s, TAKEOVER_S, "told after")


@case("pilot: ALT_HOLD, PILOT_BACK 1", "told; mission goes on")
def _(bench: Bench) -> str:
    with bench.rig(ours=["PILOT_BACK=1"]) as rig:
        rig.fly()
        seen = taken_over(rig, DEPTH_HOLD)
        time.sleep(2.0)
        mark = rig.operator.mark
        rig.mode_of_pilot(MANUAL)
        rig.operator.text("Pilot returned control", mark=mark)
        rig.operator.wait("MISSION_ITEM_REACHED", lambda m: True, LAP_S, mark)
        return f"{seen}; next item"


@case("pilot disarms", "told, disarmed")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark, begin_s = rig.operator.mark, time.monotonic()
        rig.pilot.command(ARM, 0.0, FORCE)
        told_s, _ = rig.operator.text("Flight controller disarmed", mark=mark)
        rig.until_disarmed()
        return below(rig, told_s - begin_s, TOLD_S, "told after")


def rivalled(rig: Rig, name: str, *fields: int) -> str:
    mark, begin_s = rig.operator.mark, time.monotonic()
    for _turn in range(RIVAL_TURNS):
        rig.pilot.say(name, *fields)
        time.sleep(RIVAL_EVERY_S)
    told_s, _ = rig.operator.text("another sender", mark=mark)
    return below(rig, told_s - begin_s, RIVAL_TOLD_S, "told after")


@case("second sender: joystick", "failsafe SENDER")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        return rivalled(rig, "manual_control", *JOYSTICK)


@case("second sender: override", "failsafe SENDER")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        return rivalled(rig, "rc_channels_override", 1, 1, 1500, 1500, 1500, 1700, 1500, 1500, 65535, 65535)


@case("radio receiver, RC_PROTOCOLS 0", "no effect", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark = rig.operator.mark
        port = 5501 + 10 * rig.instance
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            for _turn in range(150):
                radio.sendto(struct.pack("<8H", 1500, 1500, 1500, 1800, 1800, 1500, 1500, 1500), (LOCAL, port))
                time.sleep(0.02)
        texts = [m.text for _, m in rig.operator.since(mark, "STATUSTEXT") if m.severity <= WARNING]
        must(not texts, f"{texts}")
        rig.operator.wait("MISSION_ITEM_REACHED", lambda m: True, LAP_S, mark)
        return "no warning"


# The service


@case("service killed", "neutral after 0.4 s, armed")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        return killed(rig)


def killed(rig: Rig) -> str:
    assert rig.service is not None
    mark, begin_s = rig.pilot.mark, time.monotonic()
    rig.service.kill()
    seen = below(rig, rig.neutral_s(mark, begin_s), NEUTRAL_S, "neutral after")
    must(rig.is_armed(), "it disarmed by itself")
    return seen


@case("service started again", "found armed, disarmed")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        killed(rig)
        mark = rig.operator.mark
        rig.start_service()
        rig.operator.text("found ARMED", READY_S, mark)
        rig.operator.command(ARM, 0.0)
        rig.below_until(armed=False)
        rig.until_ready()
        rig.arm()
        return "so; armed again"


@case("service ended (SIGTERM)", "neutral, disarmed")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        assert rig.service is not None
        mark, begin_s = rig.pilot.mark, time.monotonic()
        rig.service.terminate()
        seen = below(rig, rig.neutral_s(mark, begin_s), NEUTRAL_S, "neutral after")
        rig.below_until(armed=False)
        return f"{seen}, disarmed"


@case("service frozen for 3 s", "neutral after 0.4 s; on, or told")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        return frozen(rig)


def frozen(rig: Rig) -> str:
    assert rig.service is not None
    mark, begin_s = rig.pilot.mark, time.monotonic()
    rig.service.send_signal(signal.SIGSTOP)
    seen = below(rig, rig.neutral_s(mark, begin_s), NEUTRAL_S, "neutral after")
    time.sleep(3.0 - (time.monotonic() - begin_s))
    mark = rig.operator.mark
    rig.service.send_signal(signal.SIGCONT)
    rig.operator.wait("HEARTBEAT", lambda m: m.get_srcComponent() == 1, 20.0, mark)
    time.sleep(5.0)
    texts = [m.text for _, m in rig.operator.since(mark, "STATUSTEXT") if m.severity <= WARNING]
    must(rig.turning or bool(texts), "stands still without a word")
    return f"{seen}; then {'under way' if rig.turning else texts[0]}"


@case("operator kills", "neutral, disarmed")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark, begin_s = rig.pilot.mark, time.monotonic()
        must(rig.operator.command(ARM, 0.0, FORCE) == 0, "refused")
        neutral_s = rig.neutral_s(mark, begin_s)
        rig.below_until(armed=False, mark=mark)
        return below(rig, neutral_s, 0.3, "neutral after")


@case("operator lost, FS_GCS_ENABLE 3", "HOLD after 5 s; on")
def _(bench: Bench) -> str:
    with bench.rig(ours=["FS_GCS_ENABLE=3"]) as rig:
        rig.fly()
        mark, rig.operator.beating = rig.operator.mark, False
        begin_s = time.monotonic()
        told_s, _ = rig.operator.text("Failsafe HOLD: ground station lost", mark=mark)
        rig.figures["HOLD after, s"] = told_s - begin_s
        rig.operator.beating = True
        must(rig.is_armed(), "ArduSub disarmed")
        rig.operator.text("Failsafe over: ground station lost", mark=mark)
        must(rig.operator.command(MISSION_START) == 0, "the mission does not go on")
        rig.operator.wait("MISSION_ITEM_REACHED", lambda m: True, LAP_S)
        return f"HOLD after {told_s - begin_s:.1f} s; next item"


# The flight controller


@case("ArduSub reboots", "told; arms again", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        mark, begin_s = rig.operator.mark, time.monotonic()
        rig.pilot.say("command_long", 1, 1, REBOOT, 0, 1.0, *(0.0,) * 4, EVEN_ARMED, 0.0)
        told_s, _ = rig.operator.text("Flight controller disarmed", READY_S, mark)
        seen = below(rig, told_s - begin_s, TOLD_S, "told after")
        time.sleep(5.0)
        rig.until_ready()
        rig.arm()
        return f"{seen}; armed again"


@case("cable out for 8 s", "told; arms again")
def _(bench: Bench) -> str:
    with bench.rig() as rig:
        rig.fly()
        stopped = rig.water if rig.ardusub is None else rig.ardusub
        mark, begin_s = rig.operator.mark, time.monotonic()
        stopped.send_signal(signal.SIGSTOP)
        told_s, text = rig.operator.text("Failsafe", READY_S, mark)
        rig.figures["told after, s"] = told_s - begin_s
        time.sleep(max(0.0, 8.0 - (time.monotonic() - begin_s)))
        mark = rig.operator.mark
        stopped.send_signal(signal.SIGCONT)
        time.sleep(4.0)
        rig.operator.command(ARM, 0.0, FORCE)
        rig.below_until(armed=False)
        rig.until_ready()
        rig.arm()
        return f"{text} after {told_s - begin_s:.1f} s; armed again"


@case("ArduSub's clock 1 s late", "on, or surfaces; no reset")
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
        return texts[0] if texts else "on"


@case("leak, by the autopilot", "SURFACE", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig(parameters={"FS_LEAK_ENABLE": 1.0}) as rig:
        rig.fly()
        mark, begin_s = rig.operator.mark, time.monotonic()
        rig.pilot.set_parameter("SIM_PIN_MASK", LEAK_BIT)
        told_s, _ = rig.operator.text("Failsafe SURFACE: water in the hull", mark=mark)
        return below(rig, told_s - begin_s, 10.0, "SURFACE after")


@case("leak, by ArduSub", "makes way", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig(parameters={"FS_LEAK_ENABLE": 2.0}) as rig:
        rig.fly()
        mark, heard, begin_s = rig.operator.mark, rig.pilot.mark, time.monotonic()
        rig.pilot.set_parameter("SIM_PIN_MASK", LEAK_BIT)
        told_s, text = rig.operator.text("Pilot has control", mark=mark)
        rig.figures["told after, s"] = told_s - begin_s
        rig.pilot.wait("HEARTBEAT", lambda m: m.get_srcComponent() == 1 and m.custom_mode == SURFACE, 20.0, heard)
        return text


@case("low battery, ArduSub disarms", "told, disarmed", real_only=True)
def _(bench: Bench) -> str:
    with bench.rig(parameters={"BATT_MONITOR": 4.0, "BATT_FS_LOW_ACT": 2.0, "BATT_LOW_TIMER": 1.0}) as rig:
        rig.fly()
        mark, begin_s = rig.operator.mark, time.monotonic()
        rig.pilot.set_parameter("BATT_LOW_VOLT", 30.0)
        told_s, _ = rig.operator.text("Flight controller disarmed", mark=mark)
        rig.until_disarmed()
        return below(rig, told_s - begin_s, TOLD_S, "told after")


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


@case("FS_PILOT_TIMEOUT 3", "arming denied")
def _(bench: Bench) -> str:
    return _refused(bench.rig(parameters={"FS_PILOT_TIMEOUT": 3.0}), "FS_PILOT_TIMEOUT")


@case("RC_PROTOCOLS 1", "arming denied")
def _(bench: Bench) -> str:
    return _refused(bench.rig(parameters={"RC_PROTOCOLS": 1.0}), "RC_PROTOCOLS")


@case("file vectored_6dof, ArduSub vectored", "arming denied")
def _(bench: Bench) -> str:
    return _refused(bench.rig(file_frame="vectored_6dof"), "FRAME_CONFIG")


@case("ArduSub's pre-arm check", "arming denied", real_only=True)
def _(bench: Bench) -> str:
    return _refused(bench.rig(parameters={"BATT_MONITOR": 4.0, "BATT_ARM_VOLT": 30.0}), "Battery")


@case("lights by DO_SET_SERVO", "output 13")
def _(bench: Bench) -> str:
    with bench.rig(parameters={"SERVO13_FUNCTION": 0.0}) as rig:
        rig.upload()
        rig.until_ready()
        return lit(rig)


def lit(rig: Rig) -> str:
    mark, begin_s = rig.pilot.mark, time.monotonic()
    must(rig.operator.command(SET_SERVO, float(LIGHTS), 1700.0) == 0, "refused")
    t_s, _ = rig.pilot.wait("SERVO_OUTPUT_RAW", lambda m: m.port == 0 and m.servo13_raw == 1700, 10.0, mark)
    return below(rig, t_s - begin_s, 10.0, "1700 us after")
