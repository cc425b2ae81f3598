"""Exceptions inside the service, devices that go, far places, numbers that do not fit, a fuzzer."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import development as mav

from autopilot.core.errors import DriverError
from autopilot.core.messages import Failsafe, Outputs
from autopilot.core.plan import PlanKind
from autopilot.core.samples import AhrsSample, PoseSample, Sample
from autopilot.mission.paper import paper_plan
from tests.bench.faults.finding import Finding, Measured
from tests.bench.faults.pilot import PilotedFlight, piloted
from tests.bench.fuzz.run import run_fuzz

FALLBACK_S = 2.0
"""FS_FAULT_TIME of these flights."""
FUZZED = 15_000
"""Messages of the table's fuzzer; `autopilot bench fuzz` takes a million."""
WILD_M_S2 = 10.0
GAP_S = 4.0


def _broken(*_: object, **__: object) -> Any:
    """Stands where a part of the service was."""
    raise ZeroDivisionError("broken on purpose")


@contextmanager
def _under_way() -> Iterator[PilotedFlight]:
    """On the paper's mission, with the guard as on a vehicle."""
    with piloted("paper-tank", {"FS_FAULT_TIME": FALLBACK_S}) as flight:
        flight.session.parts.guard.raises = False
        flight.upload(PlanKind.MISSION, paper_plan(1).mission)
        flight.start()
        flight.fly(3.0)
        yield flight


def _fly(flight: PilotedFlight, seconds: float) -> list[Outputs]:
    return [flight.tick() for _ in range(round(seconds * 100))]


def _at_rest(flight: PilotedFlight, outputs: Outputs) -> bool:
    return {pulse for pulse in outputs.command.pwm_us if pulse} == {flight.session.vehicle.drive.neutral_us}


def _beats(ticks: Sequence[Outputs]) -> int:
    return sum(frame.data[7:10] == bytes(3) for tick in ticks for frame in tick.mavlink_tx)


def _controller_fails() -> Measured:
    with _under_way() as flight:
        flight.session.parts.controller.step = _broken  # type: ignore[method-assign]
        here = flight.session.device.truth.pos_ned_m.copy()
        held = _fly(flight, FALLBACK_S - 0.1)
        drift_m = float(np.linalg.norm(flight.session.device.truth.pos_ned_m - here))
        rest = _fly(flight, 2.0)[20:]
        neutral = all(_at_rest(flight, tick) for tick in rest)
        armed = all(tick.mode.armed for tick in (*held, *rest))
        said = any("Internal fault: controller" in text for text in flight.pilot.texts())
        text = f"kept its place to {drift_m:.2f} m for {FALLBACK_S:g} s, then {'neutral' if neutral else 'NOT NEUTRAL'}"
        return Measured(
            text=f"{text}; {_beats([*held, *rest])} heartbeats in 4 s",
            kept=neutral and armed and said and drift_m < 0.5,
        )


def _fails_twice() -> Measured:
    with _under_way() as flight:
        flight.session.parts.estimator.step = _broken  # type: ignore[method-assign]
        ticks = _fly(flight, 2.0)
        disarmed = next((n for n, tick in enumerate(ticks) if not tick.mode.armed), None)
        rest = disarmed is not None and all(_at_rest(flight, tick) for tick in ticks[disarmed:])
        text = f"disarmed on tick {disarmed}, {_beats(ticks)} heartbeats in 2 s"
        return Measured(text=text, kept=rest and _beats(ticks) >= 2)


def _message_fails() -> Measured:
    with _under_way() as flight:
        flight.session.parts.commander.change_speed = _broken  # type: ignore[method-assign]
        for _ in range(3):
            flight.pilot.command(mav.MAV_CMD_DO_CHANGE_SPEED, 1.0, 0.2)
            flight.fly(0.3)
        answers = [m.result for m in flight.pilot.heard if m.get_type() == "COMMAND_ACK" and m.command == 178]
        flying = flight.tick().mode.armed
        text = f"answered {answers}, {'flies on' if flying else 'disarmed'}"
        return Measured(text=text, kept=flying and answers == [mav.MAV_RESULT_FAILED] * 3)


class _Failing:
    """A device of which one call fails."""

    def __init__(self, flight: PilotedFlight, call: str, error: Exception) -> None:
        self._inner, self.call, self._error = flight.session.device, call, error
        flight.session.runtime._device = self

    def __getattr__(self, name: str) -> Any:
        if name == self.call:

            def fail(*_: object) -> Any:
                raise self._error

            return fail
        return getattr(self._inner, name)


def _device_fails(call: str, for_s: float, expect: Callable[[list[Outputs]], bool], what: str) -> Measured:
    with _under_way() as flight:
        device = _Failing(flight, call, DriverError("serial line is gone; check the cable"))
        ticks = _fly(flight, for_s)
        device.call = ""
        after = _fly(flight, 1.5)
        said = sum("failed: serial line" in text for text in flight.pilot.texts())
        again = any("working again" in text for text in flight.pilot.texts())
        kept = expect([*ticks, *after]) and said == 1 and again
        return Measured(text=f"said {said} time, {what}, {'works again' if again else 'NEVER AGAIN'}", kept=kept)


def _raised(bit: Failsafe) -> Callable[[list[Outputs]], bool]:
    return lambda ticks: any(tick.mode.failsafes >> bit & 1 for tick in ticks)


def _far_home() -> Measured:
    places = ((20.0, -160.0), (38.2, 23.779), (-37.9, -156.2), (88.9, 23.7))
    with piloted("paper-tank") as flight:
        flight.fly(2.0)
        before, answers = flight.session.parts.plans.home, []
        for lat, lon in places:
            where = (round(lat * 1e7), round(lon * 1e7), 0.0)
            flight.pilot._out.append(
                mav.MAVLink_command_int_message(1, 1, 0, mav.MAV_CMD_DO_SET_HOME, 0, 0, 0.0, 0.0, 0.0, 0.0, *where)
            )
            flight.fly(0.3)
        answers = [m.result for m in flight.pilot.heard if m.get_type() == "COMMAND_ACK"]
        reason = next((text for text in flight.pilot.texts() if "Home denied" in text), "")
        moved = flight.session.parts.plans.home is not before
        return Measured(
            text=f'{answers.count(mav.MAV_RESULT_DENIED)} of {len(places)} refused: "{reason}"',
            kept=answers == [mav.MAV_RESULT_DENIED] * len(places) and not moved,
        )


class _Lying:
    """An accelerometer with a gross offset, and no fixes for a while."""

    def __init__(self, flight: PilotedFlight) -> None:
        self._inner, self._from_us = flight.session.device, flight.t_us
        flight.session.runtime._device = self

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def poll(self, t_us: int) -> list[Sample]:
        blind = t_us - self._from_us < GAP_S * 1e6
        offset = np.array([WILD_M_S2, 0.0, 0.0])
        return [
            replace(s, accel_frd_m_s2=s.accel_frd_m_s2 + offset) if isinstance(s, AhrsSample) else s
            for s in self._inner.poll(t_us)
            if not (blind and isinstance(s, PoseSample))
        ]


def _wild_accelerometer() -> Measured:
    with _under_way() as flight:
        flight.session.parts.guard.raises = True
        _Lying(flight)
        ticks = _fly(flight, GAP_S + 2.0)
        return Measured(
            text=f"{len(ticks)} ticks without an exception, {_beats(ticks)} heartbeats", kept=_beats(ticks) > 4
        )


def _fuzzed() -> Measured:
    result = run_fuzz(FUZZED, seed=3)
    grown_mb = result.rss_end_mb - result.rss_start_mb
    text = f"{result.messages} messages, {len(result.failures)} exceptions or broken rules, {grown_mb:+.0f} MB"
    return Measured(text=text, kept=not result.failures and grown_mb < 50.0)


FINDINGS = (
    Finding(
        part="guard",
        name="the controller raises an exception in flight",
        before="process ended",
        promise="station keeping for FS_FAULT_TIME, then neutral; armed, said, heartbeats go on",
        measure=_controller_fails,
    ),
    Finding(
        part="guard",
        name="the estimator raises the same exception again and again",
        before="process ended",
        promise="the second disarms; heartbeats go on",
        measure=_fails_twice,
    ),
    Finding(
        part="guard",
        name="the handler of a command raises an exception",
        before="process ended",
        promise="answered FAILED, nothing else changes",
        measure=_message_fails,
    ),
    Finding(
        part="guard",
        name="sensors' serial line gone for 1.5 s (DriverError out of poll)",
        before="process ended",
        promise="said, AHRS failsafe, tried again",
        measure=lambda: _device_fails("poll", 1.5, _raised(Failsafe.AHRS_STALE), "AHRS failsafe"),
    ),
    Finding(
        part="guard",
        name="one thruster write fails",
        before="process ended",
        promise="neutral tried, said, the next write counts",
        measure=lambda: _device_fails("write", 0.01, lambda t: not _raised(Failsafe.THRUSTER)(t), "no failsafe"),
    ),
    Finding(
        part="guard",
        name="thruster output gone for 4.5 s",
        before="process ended",
        promise="thruster failsafe (FS_THR_ACT)",
        measure=lambda: _device_fails("write", 4.5, _raised(Failsafe.THRUSTER), "thruster failsafe"),
    ),
    Finding(
        part="guard",
        name="DO_SET_HOME at 20, -160 and other far places",
        before="process ended (ConfigError), or accepted and shown elsewhere",
        promise="refused beyond 10 km, with distance and remedy",
        measure=_far_home,
    ),
    Finding(
        part="guard",
        name="accelerometer offset 10 m/s2 in a gap of 4 s",
        before="process ended (OverflowError, DEBUG_VECT margin_m = -2e68)",
        promise="goes on",
        measure=_wild_accelerometer,
    ),
    Finding(
        part="guard",
        name="hostile messages and wild samples (short form; the long one is bench fuzz)",
        before="process ended (battery of 1e308 V: OverflowError)",
        promise="no exception, rules hold, bounded memory",
        measure=_fuzzed,
    ),
)
