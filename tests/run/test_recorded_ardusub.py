"""The emulated ArduSub against what the real one did in the same cases (tests/bench/ardusub), in lockstep."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ardusub_tank import Tank

from autopilot.core.messages import Outputs
from tests.bench.ardusub import recording
from tests.bench.ardusub.cases import JOYSTICK, RIVAL_EVERY_S
from tests.bench.ardusub.rig import ARM, DEPTH_HOLD, FORCE, MANUAL, STABILIZE
from tests.bench.ardusub.swings import swung

RECORDED = recording.read()
RECORDED_BUSY_S = 0.05
"""Lockstep waits for nobody; the recorded flight's processes waited for one another."""


class Measured(Tank):
    """... and how long things take [s]."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, PILOT_BACK=1.0, FS_GCS_ENABLE=3.0)
        self.below.parameters |= {"FS_PILOT_TIMEOUT": 0.4}

    def fly(self) -> None:
        self.run(lambda o: o.progress is not None and o.progress.reached_seq >= 0 and o.goal is not None, 60.0)
        self.run(lambda _: self._turning(), 5.0)

    def _turning(self) -> bool:
        return any(pulse != 1500 for pulse in self.below.servos_us[:6])

    def told_s(self, text: str, at_most_s: float, each: Callable[[Outputs], None] = lambda _: None) -> float:
        begin_us, count = self._t_us, len(self.texts)

        def told(outputs: Outputs) -> bool:
            each(outputs)
            return any(text in line for _, line in self.texts[count:])

        self.run(told, at_most_s)
        return 1e-6 * (self._t_us - begin_us)

    def neutral_s(self, *, alone: bool) -> float:
        """``alone``: the service stands still."""
        begin_us = self._t_us
        for _ in range(200):
            if not self._turning():
                return 1e-6 * (self._t_us - begin_us)
            if alone:
                self._t_us += 10_000
                self.world_goes_on(self._t_us)
            else:
                self.run(lambda _: True, 0.01)
        pytest.fail("thrusters turn on")


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[Measured]:
    made = Measured(tmp_path)
    yield made
    made.close()


def _hold(case: str, name: str, seen: float) -> None:
    assert not recording.differences(case, {name: seen}, RECORDED, RECORDED_BUSY_S)


def test_pilot_silence_and_kill_are_as_recorded(flight: Measured) -> None:
    flight.fly()
    _hold("service killed", "neutral after, s", flight.neutral_s(alone=True))
    assert flight.below.armed
    for mode, case in (
        (STABILIZE, "pilot: STABILIZE, then MANUAL"),
        (DEPTH_HOLD, "pilot: ALT_HOLD, PILOT_BACK 1"),
    ):
        flight.run(lambda _: flight._turning(), 5.0)
        flight.pilot_mode(mode)
        _hold(case, "told after, s", flight.told_s("Pilot has control", 2.0))
        flight.pilot_mode(MANUAL)
        flight.told_s("mission resumes", 2.0)
    flight.run(lambda _: flight._turning(), 5.0)
    flight.order(flight._pilot.command_long_encode(1, 1, ARM, 0, 0, FORCE, 0, 0, 0, 0, 0))
    _hold("operator kills", "neutral after, s", flight.neutral_s(alone=False))


def test_disarming_by_the_pilot_is_as_recorded(flight: Measured) -> None:
    flight.fly()
    flight.pilot(flight._pilot.command_long_encode(1, 1, ARM, 0, 0, FORCE, 0, 0, 0, 0, 0))
    _hold("pilot disarms", "told after, s", flight.told_s("Flight controller disarmed", 3.0))


def test_a_second_sender_is_as_recorded(flight: Measured) -> None:
    flight.fly()
    joystick: Any = flight._pilot.manual_control_encode(*JOYSTICK)
    phase = np.random.default_rng(0)
    next_us = flight._t_us

    def beside(outputs: Outputs) -> None:
        nonlocal next_us
        if outputs.t_us >= next_us:
            next_us += round(1e6 * RIVAL_EVERY_S) + 10_000 * int(phase.integers(-1, 2))
            flight.pilot(joystick)

    case = "second sender: joystick"
    _hold(case, "told after, s", flight.told_s("another sender", 4.0, beside))


def test_a_cable_that_is_out_is_as_recorded(flight: Measured) -> None:
    flight.fly()
    flight.unheard = flight.deaf = True
    _hold("cable out for 8 s", "told after, s", flight.told_s("Failsafe", 5.0))


def test_a_lost_operator_is_as_recorded(flight: Measured) -> None:
    flight.fly()
    flight._operator = None
    _hold("operator lost, FS_GCS_ENABLE 3", "HOLD after, s", flight.told_s("Failsafe HOLD: ground station lost", 10.0))
    assert flight.below.armed


def test_a_mission_swings_as_recorded(flight: Measured) -> None:
    """The hull does: it is the same on both, and ArduSub does nothing to pitch in MANUAL."""
    rows: list[tuple[float, ...]] = []

    def track(outputs: Outputs) -> None:
        if outputs.t_us % 100_000 == 0:
            rows.append((0.0, 0.0, 0.0, 0.0, *flight.world.truth.rpy_rad.tolist(), *flight.below.servos_us[:6]))

    took_s = flight.told_s("Mission complete", 120.0, track)
    assert took_s < 120.0
    recorded = RECORDED.cases["tank by poses, 3 laps"].figures["pitch rms, rad"]
    assert swung(np.array(rows)).pitch_rms_rad == pytest.approx(recorded, rel=0.4)
