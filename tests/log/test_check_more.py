"""Golden logs: a sound one passes the checks of the parts, and each of the others breaks one of them and no other."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from log_synthetic import (
    DESCRIPTION,
    EPOCH_NS,
    LEG_S,
    PROCESS,
    VIA,
    Run,
    Truth,
    heartbeat,
    inputs_at,
    loop_at,
    nav_of,
    outputs_at,
    truth_at,
)

from autopilot.core.messages import Inputs, MarkerFit, MavlinkFrame, Outputs, ProcessStats
from autopilot.core.samples import AhrsSample, ImuSample, PowerSample
from autopilot.core.vehicle import load_vehicle
from autopilot.log.check import BoundRow, BoundVerdict, acceptance_table
from autopilot.log.check_more import clipped
from autopilot.log.description import AcceptBounds, RunDescription
from autopilot.log.log_session import open_run_log
from autopilot.log.reader import open_log

STEP_US = 100_000
VEHICLE = load_vehicle("lbv150")
END_US = int(2 * LEG_S * 1e6) + 500_000
BATTERY = {**DESCRIPTION.parameters, "BATT_LOW_VOLT": 16.0}
REAL_TIME = replace(DESCRIPTION, accept=AcceptBounds(laps=1), speed=1.0, parameters=BATTERY)


def same_inputs(t_us: int, inputs: Inputs) -> Inputs:
    return inputs


def same_outputs(t_us: int, outputs: Outputs) -> Outputs:
    return outputs


def golden(
    path: Path,
    change_inputs: Callable[[int, Inputs], Inputs] = same_inputs,
    change_outputs: Callable[[int, Outputs], Outputs] = same_outputs,
    ends: bool = True,
    description: RunDescription = REAL_TIME,
    process: Callable[[float], ProcessStats] = lambda t_s: PROCESS,
    change_truth: Callable[[float, Truth], Truth] = lambda t_s, truth: truth,
    end_us: int = END_US,
    step_us: int = STEP_US,
) -> dict[str, BoundRow]:
    """The rows of a lap, changed as asked."""
    log = open_run_log(
        path,
        epoch_ns=EPOCH_NS,
        description=description,
        metadata={},
        attachments={"vehicle.json": msgspec.json.encode(VEHICLE)},
        lossless=True,
        camera_period_us=None,
    )
    for number, t_us in enumerate(range(0, end_us, step_us)):
        truth = change_truth(t_us * 1e-6, truth_at(t_us * 1e-6))
        log.truth(t_us, truth)
        inputs = replace(inputs_at(t_us, truth), mavlink_rx=(MavlinkFrame(link=0, data=heartbeat(number)),))
        log.inputs(change_inputs(t_us, inputs))
        log.outputs(change_outputs(t_us, outputs_at(t_us, truth, Run(), ends and t_us > end_us - 400_000)))
        if t_us % 1_000_000 == 0:
            log.loop(loop_at(t_us, process=process(t_us * 1e-6)))
    log.close()
    return {row.name: row for row in acceptance_table(open_log(path))}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, BoundRow]:
    """The rows of a log in which nothing is wrong."""
    return golden(tmp_path_factory.mktemp("golden") / "sound.mcap")


def warned(rows: dict[str, BoundRow]) -> set[str]:
    return {name for name, row in rows.items() if row.verdict in (BoundVerdict.WARN, BoundVerdict.FAIL)}


def aids(**changes: Any) -> Callable[[int, Outputs], Outputs]:
    return lambda t_us, outputs: replace(outputs, aids=tuple(replace(aid, **changes) for aid in outputs.aids))


def swinging(t_us: int, outputs: Outputs) -> Outputs:
    """Innovations of four sigma to either side: no bias, and far too many outside."""
    sign = 1.0 if t_us // STEP_US % 2 else -1.0
    off = np.array([sign * 4.0 * 1e-5**0.5, 0.0, 0.0])
    return replace(outputs, aids=tuple(replace(aid, innovation=off) for aid in outputs.aids))


def overconfident(t_us: int, outputs: Outputs) -> Outputs:
    nav = nav_of(t_us, truth_at(t_us * 1e-6))
    return replace(outputs, nav=replace(nav, variance=np.full(12, 2e-7)))


def late(t_us: int, outputs: Outputs) -> Outputs:
    assert outputs.control is not None
    slow = replace(outputs.control.status, solve_s=0.08 if t_us == 10_000_000 else 0.001)
    return replace(outputs, control=replace(outputs.control, status=slow))


def silent(t_us: int, inputs: Inputs) -> Inputs:
    heard = not 10_000_000 < t_us < 11_000_000
    return replace(
        inputs, samples=tuple(s for s in inputs.samples if heard or not isinstance(s, AhrsSample | ImuSample))
    )


def clips(rate: bool) -> Callable[[int, Inputs], Inputs]:
    """A turn rate, or a specific force, that stays at the end of the range for some samples while others go on."""

    def change(t_us: int, inputs: Inputs) -> Inputs:
        def one(sample: Any) -> Any:
            if not isinstance(sample, AhrsSample | ImuSample):
                return sample
            noise = 1e-3 * math.sin(t_us)
            rates = np.array([1e-3, noise, 2.6179939 if rate and 10_000_000 <= t_us < 10_500_000 else noise])
            forces = np.array([noise, 19.62 if not rate and 10_000_000 <= t_us < 10_500_000 else 0.0, -9.81])
            return replace(sample, rate_frd_rad_s=rates, accel_frd_m_s2=forces)

        return replace(inputs, samples=tuple(one(s) for s in inputs.samples))

    return change


def empty(t_us: int, inputs: Inputs) -> Inputs:
    return replace(
        inputs, samples=tuple(replace(s, voltage_v=15.9) if isinstance(s, PowerSample) else s for s in inputs.samples)
    )


def lossy(t_us: int, inputs: Inputs) -> Inputs:
    return replace(inputs, mavlink_rx=() if t_us // STEP_US % 10 == 3 else inputs.mavlink_rx)


def fits(**changes: Any) -> Callable[[int, Outputs], Outputs]:
    fit = replace(MarkerFit(known=12, used=12, rms_px=0.15, worst_px=0.6), **changes)
    return aids(fit=fit)


def timesync(answer: int, ours_ns: int) -> bytes:
    """A MAVLink 2 TIMESYNC without a valid checksum, cut behind its last byte that is not zero."""
    payload = (answer.to_bytes(8, "little") + ours_ns.to_bytes(8, "little")).rstrip(b"\0")
    return bytes([0xFD, len(payload), 0, 0, 0, 2, 1, 111, 0, 0]) + payload + b"\x12\x34"


def asks(t_us: int, outputs: Outputs) -> Outputs:
    """A TIMESYNC every five seconds."""
    asked = (MavlinkFrame(link=0, data=timesync(0, t_us * 1000)),) if t_us % 5_000_000 == 0 else ()
    return replace(outputs, mavlink_tx=(*outputs.mavlink_tx, *asked))


def answers(after_us: int) -> Callable[[int, Inputs], Inputs]:
    """The client answers so late, and somebody else's answer comes in between."""

    def answer(t_us: int, inputs: Inputs) -> Inputs:
        asked_us = t_us - after_us
        if asked_us < 0 or asked_us % 5_000_000:
            return inputs
        frames = [timesync(77, asked_us * 1000), timesync(78, 123)]
        return replace(inputs, mavlink_rx=(*inputs.mavlink_rx, *(MavlinkFrame(link=0, data=f) for f in frames)))

    return answer


HELD_FROM_S = 2 * LEG_S - 4.0
HELD = {"end_us": int((HELD_FROM_S + 14.0) * 1e6)}


def held(t_us: int, outputs: Outputs) -> Outputs:
    """Near its end the tour's first place is the goal, and stays so."""
    if t_us < 1e6 * HELD_FROM_S or outputs.goal is None:
        return outputs
    return replace(outputs, goal=replace(outputs.goal, pos_ned_m=VIA[0], seq=3, accept_radius_m=0.3))


def swings(by_m: float, until_s: float) -> Callable[[float, Truth], Truth]:
    """It comes to the place, goes beyond it, and to and fro until a time after ``HELD_FROM_S``; then it rests."""

    def swing(t_s: float, truth: Truth) -> Truth:
        if t_s < HELD_FROM_S:
            return truth
        after_s = t_s - HELD_FROM_S
        off = 0.25 - (0.25 + by_m) * after_s if after_s < 1.0 else -by_m * np.cos(np.pi * (after_s - 1.0))
        return replace(truth, pos_ned_m=VIA[0] + np.array([off if after_s < until_s else 0.01, 0.0, 0.0]))

    return swing


def test_a_sound_log_passes(sound: dict[str, BoundRow]) -> None:
    rows = sound
    assert warned(rows) == set()
    assert rows["path length"].worst == pytest.approx(2 * 4.0, rel=0.1)
    assert rows["NEES of the position"].worst == pytest.approx(0.32, abs=0.05)
    assert rows["parameters changed"].note == "MPC_Q_POS"
    assert rows["commands refused"].worst == 0.0
    assert all(row.subject for row in rows.values())


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("log ended within a mission", {"ends": False}),
        ("markers: innovations within 95 %", {"change_outputs": swinging}),
        ("markers: bias over sigma", {"change_outputs": aids(innovation=np.array([0.0, 0.004, 0.0]))}),
        ("NEES of the position", {"change_outputs": overconfident}),
        ("control steps beyond their period", {"change_outputs": late}),
        ("longest time between samples", {"change_inputs": silent}),
        ("saturated samples", {"change_inputs": clips(rate=True)}),
        ("saturated samples", {"change_inputs": clips(rate=False)}),
        ("lowest voltage", {"change_inputs": empty}),
        ("inbound MAVLink messages lost", {"change_inputs": lossy}),
        ("reprojection error, rms", {"change_outputs": fits(rms_px=1.3, worst_px=4.0)}),
        ("rejected markers", {"change_outputs": fits(used=10)}),
        ("MAVLink round trip, p95", {"change_inputs": answers(1_200_000), "change_outputs": asks}),
        ("log queue", {"process": lambda t_s: replace(PROCESS, log_queue=15_000)}),
        ("overshoot at a goal", {"change_outputs": held, "change_truth": swings(0.35, 5.0), **HELD}),
        ("goals without coming to rest", {"change_outputs": held, "change_truth": swings(0.15, 99.0), **HELD}),
    ],
)
def test_each_golden_log_breaks_its_check(tmp_path: Path, name: str, changes: dict[str, Any]) -> None:
    rows = golden(tmp_path / "a.mcap", **changes)
    assert warned(rows) == {name}
    assert rows[name].verdict is BoundVerdict.WARN


def test_a_sensor_that_stops_or_counts_in_large_steps_is_not_clipped() -> None:
    rng = np.random.default_rng(5)
    rates, forces = rng.normal(size=(500, 3)) * 3.0, rng.normal(size=(500, 3)) * 30.0
    assert clipped(rates, forces) == (0, 0)
    stopped = np.repeat(rates[:1], 500, axis=0) + 20.0, np.repeat(forces[:1], 500, axis=0) + 200.0
    assert clipped(*stopped) == (0, 0)
    assert clipped(np.round(rng.normal(size=(5000, 3)) * 0.002, 3), np.round(rng.normal(size=(5000, 3)), 1)) == (0, 0)
    assert clipped(rates[:0], forces[:0]) == (0, 0)
    for end in (2.0, -2.0):
        at_the_end = np.minimum(rates, 2.0) if end > 0 else np.maximum(rates, -2.0)
        assert clipped(at_the_end, forces)[0] > 20 and clipped(at_the_end, forces)[1] == 0


def test_what_the_current_spared(sound: dict[str, BoundRow], tmp_path: Path) -> None:
    """Half of the speed through the water: an eighth (quadratic drag) to a quarter (linear) of the work."""

    def carried(t_s: float, truth: Truth) -> Truth:
        return replace(truth, vel_water_frd_m_s=0.5 * truth.vel_frd_m_s)

    name = "drag work relative to still water"
    assert sound[name].worst == pytest.approx(100.0)
    row = golden(tmp_path / "b.mcap", change_truth=carried)[name]
    assert row.worst is not None and 12.5 <= row.worst <= 25.0


def test_refused_commands_are_named(tmp_path: Path) -> None:
    def refuse(t_us: int, outputs: Outputs) -> Outputs:
        payload = bytes([400 & 0xFF, 400 >> 8, 2])
        frame = bytes([0xFD, 3, 0, 0, 1, 1, 1, 77, 0, 0]) + payload + b"\x12\x34"
        return replace(outputs, mavlink_tx=(MavlinkFrame(link=0, data=frame),)) if t_us == 10_000_000 else outputs

    row = golden(tmp_path / "a.mcap", change_outputs=refuse)["commands refused"]
    assert row.worst == 1.0 and row.note == "MAV_CMD (MAV_RESULT): 400 (2)"


def test_thrust_and_energy_are_told_by_thruster_and_waypoint(tmp_path: Path) -> None:
    limit_n = DESCRIPTION.paper_bounds["thrust_n"]

    def pushes(t_us: int, outputs: Outputs) -> Outputs:
        """Port twice as strong as starboard, and three times at its limit."""
        thrust = np.array([6.0, 3.0, -1.0, 0.5, 0.0, 0.0, 0.0, 0.0])
        if t_us in (1_000_000, 1_100_000, 2_000_000, 3_000_000):
            thrust[0] = limit_n
        return replace(outputs, command=replace(outputs.command, thrust_n=thrust))

    names = ("port", "starboard", "vertical", "lateral")
    rows = golden(tmp_path / "a.mcap", change_outputs=pushes, description=replace(REAL_TIME, thruster_names=names))
    hits = rows["thruster saturations"]
    assert (hits.worst, hits.note) == (3.0, "port 3, starboard 0, vertical 0, lateral 0")
    assert rows["thrust imbalance, port over starboard"].worst == pytest.approx(100.0 / 3.0, abs=2.0)
    legs = rows["energy from waypoint to waypoint, median"]
    assert legs.worst is not None and 0.0 < legs.worst < (rows["energy"].worst or 0.0)
    assert "in lap 1" in legs.note
    nameless = golden(tmp_path / "b.mcap", change_outputs=pushes)
    assert "thrust imbalance, port over starboard" not in nameless


def test_a_goal_that_is_held_tells_overshoot_and_settling(sound: dict[str, BoundRow], tmp_path: Path) -> None:
    rows = golden(tmp_path / "a.mcap", change_outputs=held, change_truth=swings(0.15, 5.0), **HELD)
    assert not warned(rows)
    assert rows["overshoot at a goal"].worst == pytest.approx(0.15, abs=0.01)
    assert rows["settling time in a goal's region"].worst == pytest.approx(5.0, abs=0.6)
    assert "settling time in a goal's region" not in sound, "both goals are flown through"


def test_round_trips_are_those_of_our_own_requests(tmp_path: Path) -> None:
    row = golden(tmp_path / "a.mcap", answers(300_000), asks)["MAVLink round trip, p95"]
    assert row.worst == pytest.approx(0.3) and row.note.endswith("of 8")
    assert "MAVLink round trip, p95" not in golden(tmp_path / "b.mcap", change_outputs=asks)
    fast = replace(REAL_TIME, speed=0.0)
    row = golden(tmp_path / "c.mcap", answers(3_000_000), asks, description=fast)["MAVLink round trip, p95"]
    assert row.verdict is BoundVerdict.INFO, "in lockstep clients live in another time"


def test_memory_that_grows_is_told(sound: dict[str, BoundRow], tmp_path: Path) -> None:
    def memory(grows: float) -> BoundRow:
        span = {
            "end_us": 130_000_000,
            "step_us": 1_000_000,
            "description": replace(REAL_TIME, accept=AcceptBounds(laps=None)),
        }
        leaking = golden(
            tmp_path / "a.mcap",
            process=lambda t_s: replace(PROCESS, rss_bytes=int(2e8 * (1.0 + grows * t_s))),
            **span,  # type: ignore[arg-type]
        )
        return leaking["memory"]

    assert memory(0.0).verdict is BoundVerdict.PASS
    assert memory(0.01).verdict is BoundVerdict.WARN
    assert sound["memory"].verdict is BoundVerdict.INFO, "too short to say"


def test_energy_is_told_by_thruster(sound: dict[str, BoundRow]) -> None:
    """Of the vehicle file's c |F|^1.5, and what is left for everything else."""
    rows = sound
    port = VEHICLE.thrusters[0]
    assert rows["energy of the thrusters"].note.startswith(
        f"{port.name} {port.drive.power_w_n15 * 3.0**1.5 * (1e-6 * END_US - 0.1):.0f}, "
    )
    energy, rest = rows["energy"].worst, rows["energy of other loads"].worst
    assert energy is not None and rest is not None
    assert rest == pytest.approx(energy - (rows["energy of the thrusters"].worst or 0.0))


def test_ticks_and_threads_are_told_with_their_times(sound: dict[str, BoundRow]) -> None:
    assert sound["tick p50"].worst == pytest.approx(2.0) and "of CPU 1.00 ms" in sound["tick p50"].note
    assert sound["tick p99"].worst == pytest.approx(4.0) and "of CPU 3.00 ms" in sound["tick p99"].note
    threads = {name: row.worst for name, row in sound.items() if name.startswith("CPU, ")}
    assert threads == pytest.approx({"CPU, loop": 200.0, "CPU, vision": 70.0, "CPU, other": 30.0})
    assert list(threads) == ["CPU, loop", "CPU, vision", "CPU, other"], "the most first; idle ones are not listed"
