"""`autopilot run`'s composition on the emulated BlueROV2: service, driver and wire as on the vehicle, in lockstep."""

from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from ardusub_tank import Tank, tanks

from autopilot.core.messages import Outputs
from autopilot.log.reader import open_log
from autopilot.mavlink.api import FlightMode
from autopilot.replay.service_replay import replay_service
from autopilot.run.vehicle_config import config_names, load_config


@pytest.fixture
def tank(tmp_path: Path) -> Iterator[Callable[..., Tank]]:
    with tanks(Tank, tmp_path) as made:
        yield made


class Held:
    """A clock that is what the ticks say, but for one stop of the loop in which the world goes on."""

    def __init__(self, flight: Tank) -> None:
        self._flight = flight
        self.now = flight._t_us

    def hold(self, for_us: int) -> None:
        end_us = self.now + for_us
        while self.now < end_us:
            self.now += 10_000
            self._flight.world_goes_on(self.now)

    def now_us(self) -> int:
        return self.now

    def wait_until(self, t_us: int) -> int:
        self.now = max(self.now, t_us)
        return self.now

    def left_s(self, t_us: int) -> float:
        return 0.0


def _flies(outputs: Outputs) -> bool:
    return outputs.progress is not None and outputs.progress.reached_seq >= 0 and outputs.goal is not None


def test_a_pilot_takes_the_vehicle_in_a_mission_gives_it_back_and_stops_it(tank: Callable[..., Tank]) -> None:
    flight = tank(PILOT_BACK=1.0)
    commander = flight.session.parts.commander
    flight.run(_flies, 60.0)
    assert flight.below.armed
    flight.run(lambda outputs: bool(outputs.t_us % 1_000_000 == 0), 2.0)
    flight.pilot_mode(0)
    count = len(flight.texts)
    flight.run(lambda _: True, 0.01)
    flight.run(lambda _: True, 0.01)  # what is said on one tick is heard on the next
    assert any("Pilot has control (STABILIZE): autopilot waits" in line for _, line in flight.texts[count:])
    assert commander.armed and commander.mode is FlightMode.HOLD
    end_us = flight._t_us + 1_500_000  # later he would be at a pillar

    def steers(outputs: Outputs) -> bool:
        flight.stick(-150)
        return outputs.t_us >= end_us

    flight.run(steers, 4.0)
    assert flight.below.armed
    # His stick alone is on the motors: -150 of 1000 at half gain is 30 us astern.
    assert sorted(set(flight.below.servos_us[:4])) == [1470, 1530]
    flight.stick(0)
    flight.pilot_mode(19)
    flight.run(lambda _: commander.mode is FlightMode.MISSION, 0.1)
    assert flight.reported("Pilot returned control: mission resumes")
    touched = flight.world.truth.contact_count  # by his hand
    assert not flight.reported("Failsafe")
    # Once more: without the parameter it holds.
    flight.session.parts.params.set("PILOT_BACK", 0.0)
    flight.pilot_mode(2)
    flight.run(lambda _: flight.reported("Pilot has control (ALT_HOLD)"), 0.1)
    flight.pilot_mode(19)
    flight.run(lambda _: flight.reported("Pilot returned control: holding"), 0.1)
    assert commander.mode is FlightMode.HOLD and commander.armed
    where, end_us = flight.world.truth.pos_ned_m, flight._t_us + 3_000_000
    flight.run(lambda outputs: outputs.t_us >= end_us, 4.0)
    assert ((flight.world.truth.pos_ned_m - where) ** 2).sum() < 0.5**2
    # And stopped below: the end of the flight, for the service too.
    flight.pilot(flight._pilot.command_long_encode(1, 1, 400, 0, 0, 0, 0, 0, 0, 0, 0))
    flight.run(lambda outputs: not outputs.mode.armed, 0.1)
    flight.run(lambda _: flight.reported("Flight controller disarmed"), 0.1)
    assert flight.world.truth.contact_count == touched


@pytest.mark.parametrize("rearmed", [False, True])
def test_disarmed_by_its_pilot_in_his_mode_the_flight_is_over(tank: Callable[..., Tank], rearmed: bool) -> None:
    flight = tank(PILOT_BACK=1.0)
    commander = flight.session.parts.commander
    flight.run(_flies, 60.0)
    flight.pilot_mode(2)
    flight.run(lambda _: flight.reported("Pilot has control (ALT_HOLD)"), 0.1)
    flight.pilot(flight._pilot.command_long_encode(1, 1, 400, 0, 0, 0, 0, 0, 0, 0, 0))
    flight.run(lambda outputs: not outputs.mode.armed, 0.1)
    flight.run(lambda _: flight.reported("Flight controller disarmed"), 0.1)
    if rearmed:
        flight.pilot(flight._pilot.command_long_encode(1, 1, 400, 0, 1, 21196, 0, 0, 0, 0, 0))
    flight.pilot_mode(19)
    end_us = flight._t_us + 7_000_000
    flight.run(lambda outputs: outputs.t_us >= end_us, 8.0)
    assert flight.below.armed is rearmed and not commander.armed


def test_what_is_refused_at_first_is_armed_later_though_thrust_is_wanted_meanwhile(tank: Callable[..., Tank]) -> None:
    """It arms with neutral channels only."""
    flight = tank()
    flight.run(lambda outputs: outputs.mode.armed, 20.0)
    flight.below.objection = "Compass not healthy"
    flight.run(lambda outputs: max(map(abs, outputs.command.thrust_n)) > 1.0, 3.0)
    assert not flight.below.armed
    assert set(flight.below._channels) == {1500}
    flight.below.objection = ""
    flight.run(lambda _: flight.below.armed, 3.0)
    flight.run(lambda _: set(flight.below._channels) != {1500}, 1.0)
    flight.run(_flies, 60.0)


def test_a_loop_that_was_held_for_half_a_second_goes_on_with_the_present(tank: Callable[..., Tank]) -> None:
    """What devices have measured meanwhile comes at once, with its own times."""
    flight = tank()
    flight.run(_flies, 60.0)
    runtime, clock = flight.session.runtime, Held(flight)
    runtime._clock, runtime._skips = clock, True
    ticks: list[int] = []
    before, number = runtime.counters.overruns, flight._t_us // 10_000
    due, begun = runtime.counters.due, number
    for count in range(300):
        if count == 100:
            clock.hold(600_000)
        number += 1 + runtime.late_ticks(number + 1)
        ticks.append(number * 10_000)
        runtime.tick(ticks[-1])
    flight._t_us = ticks[-1]
    assert max(later - one for one, later in pairwise(ticks)) > 500_000
    assert 50 <= runtime.counters.overruns - before <= number - begun == runtime.counters.due - due
    assert flight.outputs is not None and flight.outputs.mode.armed
    assert not flight.reported("AHRS silent"), flight.texts[-10:]


def test_a_flight_controller_that_is_not_heard_for_a_while_is_not_disarmed(tank: Callable[..., Tank]) -> None:
    flight = tank()
    flight.run(_flies, 60.0)
    flight.unheard = True
    end_us = flight._t_us + 1_700_000  # longer than it takes until the link is opened anew, too
    flight.run(lambda outputs: not flight.below.armed or outputs.t_us >= end_us, 2.0)
    assert flight.below.armed and flight.session.parts.commander.armed
    assert flight.reported("Thrusters failed: flight controller is silent")
    assert sorted(set(flight.below.servos_us[:4])) == [1500]
    flight.unheard = False
    flight.run(lambda _: flight.reported("Thrusters: working again"), 3.0)
    # The failsafe of the AHRS, which comes by the same line, may have brought it up meanwhile.
    assert flight.reported("Surfaced") or (flight.below.armed and flight.session.parts.commander.armed)
    assert not flight.reported("Flight controller disarmed")


def test_what_a_late_tick_finds_ahead_of_its_time_is_kept_for_the_next(tank: Callable[..., Tank]) -> None:
    flight = tank()
    flight.run(_flies, 60.0)

    def counted() -> dict[str, int]:
        flight.run(lambda outputs: outputs.counters is not None, 2.0)
        assert flight.outputs is not None and flight.outputs.counters is not None
        return dict(flight.outputs.counters.counts)

    before = counted()
    for late_us in (30_000, 60_000, 90_000):
        flight.late_us = late_us
        end_us = flight._t_us + 500_000
        flight.run(lambda outputs, end_us=end_us: outputs.t_us >= end_us, 1.0)
    after = counted()
    assert after["ahrs.future"] == before["ahrs.future"]
    assert after["ahrs.good"] - before["ahrs.good"] > 75


def test_what_the_pilot_does_with_the_thrusters_is_not_taken_for_a_current(tank: Callable[..., Tank]) -> None:
    flight = tank()
    flight.run(_flies, 60.0)
    flight.pilot_mode(0)
    flight.run(lambda _: flight.reported("Pilot has control"), 0.1)
    off_m_s = []
    for turn in range(400):
        flight.stick(350 if turn // 100 % 2 else -350)
        flight.run(lambda _: True, 0.01)
        nav = flight.session.service.nav
        assert nav is not None
        off_m_s.append(float(np.abs(nav.current_ned_m_s[:2] - flight.world.truth.current_ned_m_s[:2]).max()))
    assert max(off_m_s) < 0.12


@pytest.mark.parametrize("name", config_names())
def test_shipped_configurations_are_sound(name: str) -> None:
    config = load_config(name)
    assert config.devices


def test_a_run_on_a_vehicle_replays(tank: Callable[..., Tank], tmp_path: Path) -> None:
    """With a flight controller below, poses over MAVLink and a client that arms: the same bits come out again."""
    flight = tank()
    flight.run(lambda outputs: outputs.mode.armed, 20.0)
    for _ in range(150):
        flight._t_us += 10_000
        flight.session.runtime.tick(flight._t_us)
    flight.session.runtime.close()
    flight.session.recorder.close()
    log = open_log(tmp_path / "run.mcap")
    assert "/in/below" in log and "/nav/external" in log
    result = replay_service(log)
    assert result.same, [str(one) for one in result.differences]
    assert not result.stopped
