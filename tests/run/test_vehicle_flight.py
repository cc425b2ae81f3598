"""`autopilot run`'s composition on the emulated BlueROV2: service, driver and wire as on the vehicle, in lockstep."""

from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autopilot.core.messages import Outputs
from autopilot.core.vehicle import load_vehicle
from autopilot.log.reader import open_log
from autopilot.mavlink.api import FlightMode
from autopilot.run.children import free_port
from autopilot.run.config import Settings, gather, vehicle_defaults
from autopilot.run.demo import paper_plan
from autopilot.run.hardware_session import open_vehicle
from autopilot.run.session import Session
from autopilot.run.sitl_replay import replay_service
from autopilot.run.vehicle_config import config_names, load_config
from drivers.links import open_link
from mission.plan_files import write_plan
from sitl.ardusub_vehicle import ArduSubVehicle
from sitl.operator import ScriptedOperator
from sitl.scenario import load_scenario, with_vehicle


class Tank:
    """A BlueROV2 with ArduSub in the paper's tank, the service on its companion, an operator and a pilot."""

    def __init__(self, folder: Path, **parameters: float) -> None:
        below, ours = free_port(), free_port()
        path = folder / "rov.toml"
        path.write_text(
            f'vehicle = "bluerov2"\n[devices.flight_controller]\ndriver = "ardusub"\nframe = "vectored"\n'
            f'connect = "udpin:127.0.0.1:{below}"\n'
        )
        plan = folder / "paper.plan"
        write_plan(plan, paper_plan(1))
        settings: Settings = gather(
            vehicle_defaults(0),
            {
                "connect": (f"udpin:127.0.0.1:{ours}",),
                "state_dir": str(folder),
                "log": str(folder / "run.mcap"),
                "plan": str(plan),
            },
            {},
        )
        scenario = with_vehicle(load_scenario("paper-tank"), "bluerov2", "--vehicle")
        self.world = ArduSubVehicle(scenario, load_vehicle("bluerov2"), "vectored", seed=1)
        self.below = self.world.controller
        self._wire = open_link(f"udpout:127.0.0.1:{below}")
        self._client = open_link(f"udpout:127.0.0.1:{ours}")
        self._operator = ScriptedOperator(1)
        self._pilot: Any = self.below.codec(255, 190)
        self.texts: list[tuple[float, str]] = []
        self.outputs: Outputs | None = None
        self.session: Session = open_vehicle(
            settings, load_config(str(path)), parameters, speed=0.0, on_tick=self._tick
        )
        self._t_us = 0
        self.unheard = False
        """What the flight controller says gets lost; it hears us."""
        self.late_us = 0
        """So much the loop lags behind the world."""

    def _tick(self, outputs: Outputs) -> None:
        """After the service's tick: the world goes on, and everybody speaks."""
        self.outputs = outputs
        self.texts += [(1e-6 * event.t_us, event.text) for event in outputs.events]
        t_us = outputs.t_us
        self.world_goes_on(t_us)
        pose = self.world.pose(t_us)
        if pose is not None:
            self._client.send(pose)
        for data in self._operator.step(t_us, [received.data for received in self._client.recv(t_us)]):
            self._client.send(data)

    def world_goes_on(self, t_us: int) -> None:
        """Water, vehicle and flight controller."""
        for received in self._wire.recv(t_us):
            self.below.hear(t_us, received.data)
        for data in self.world.advance(t_us + self.late_us):
            if not self.unheard:
                self._wire.send(data)

    def run(self, until: Callable[[Outputs], bool], at_most_s: float) -> None:
        """Ticks until something is so."""
        for _ in range(round(at_most_s * 100)):
            self._t_us += 10_000
            self.session.runtime.tick(self._t_us)
            assert self.outputs is not None
            if until(self.outputs):
                return
        pytest.fail(f"not within {at_most_s} s; {self.texts[-12:]}")

    def pilot(self, message: Any) -> None:
        self.below.hear(self._t_us, bytes(message.pack(self._pilot)), link=9)

    def pilot_mode(self, mode: int) -> None:
        self.pilot(self._pilot.command_long_encode(1, 1, 176, 0, 1, mode, 0, 0, 0, 0, 0))

    def stick(self, x: int) -> None:
        self.pilot(self._pilot.manual_control_encode(1, x, 0, 500, 0, 0))

    def said(self, text: str) -> bool:
        return any(text in line for _, line in self.texts)

    def close(self) -> None:
        self.session.runtime.close()
        self.session.recorder.close()
        self.session.kept.params.finish()
        if self.session.kept.plans is not None:
            self.session.kept.plans.finish()
        self.session._end_slow_work()
        self._wire.close()
        self._client.close()


@pytest.fixture
def tank(tmp_path: Path) -> Iterator[Callable[..., Tank]]:
    made: list[Tank] = []

    def make(**parameters: float) -> Tank:
        made.append(Tank(tmp_path, **parameters))
        return made[-1]

    yield make
    for each in made:
        each.close()


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
    assert any("Pilot has taken over (STABILIZE): let go" in line for _, line in flight.texts[count:])
    assert commander.armed and commander.mode is FlightMode.HOLD
    end_us = flight._t_us + 3_000_000

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
    assert flight.said("Pilot has given back: mission goes on")
    touched = flight.world.truth.contact_count  # by his hand
    assert not flight.said("Failsafe")
    # Once more: without the parameter it holds.
    flight.session.parts.params.set("PILOT_BACK", 0.0)
    flight.pilot_mode(2)
    flight.run(lambda _: flight.said("Pilot has taken over (ALT_HOLD)"), 0.1)
    flight.pilot_mode(19)
    flight.run(lambda _: flight.said("Pilot has given back: holding"), 0.1)
    assert commander.mode is FlightMode.HOLD and commander.armed
    where, end_us = flight.world.truth.pos_ned_m, flight._t_us + 3_000_000
    flight.run(lambda outputs: outputs.t_us >= end_us, 4.0)
    assert ((flight.world.truth.pos_ned_m - where) ** 2).sum() < 0.5**2
    # And stopped below: the end of the flight, for the service too.
    flight.pilot(flight._pilot.command_long_encode(1, 1, 400, 0, 0, 0, 0, 0, 0, 0, 0))
    flight.run(lambda outputs: not outputs.mode.armed, 0.1)
    flight.run(lambda _: flight.said("Stopped below"), 0.1)
    assert flight.world.truth.contact_count == touched


def test_a_loop_that_was_held_for_half_a_second_goes_on_with_the_present(tank: Callable[..., Tank]) -> None:
    """What devices have measured meanwhile comes at once, with its own times."""
    flight = tank()
    flight.run(_flies, 60.0)
    runtime, clock = flight.session.runtime, Held(flight)
    runtime._clock, runtime._skips = clock, True
    ticks: list[int] = []
    before, number = runtime.counters.overruns, flight._t_us // 10_000
    for count in range(300):
        if count == 100:
            clock.hold(600_000)
        number += 1 + runtime._too_late(number + 1)
        ticks.append(number * 10_000)
        runtime.tick(ticks[-1])
    flight._t_us = ticks[-1]
    assert max(later - one for one, later in pairwise(ticks)) > 500_000
    assert runtime.counters.overruns - before >= 50
    assert flight.outputs is not None and flight.outputs.mode.armed
    assert not flight.said("AHRS silent"), flight.texts[-10:]


def test_a_flight_controller_that_is_not_heard_for_a_while_is_not_disarmed(tank: Callable[..., Tank]) -> None:
    flight = tank()
    flight.run(_flies, 60.0)
    flight.unheard = True
    end_us = flight._t_us + 1_700_000  # longer than it takes until the link is opened anew, too
    flight.run(lambda outputs: not flight.below.armed or outputs.t_us >= end_us, 2.0)
    assert flight.below.armed and flight.session.parts.commander.armed
    assert flight.said("Thrusters failed: flight controller is silent")
    assert sorted(set(flight.below.servos_us[:4])) == [1500]
    flight.unheard = False
    flight.run(lambda _: flight.said("Thrusters: working again"), 3.0)
    # The failsafe of the AHRS, which comes by the same line, may have brought it up meanwhile.
    assert flight.said("Surfaced") or (flight.below.armed and flight.session.parts.commander.armed)
    assert not flight.said("Stopped below")


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
    assert after["ahrs.good"] - before["ahrs.good"] > 150


def test_what_the_pilot_does_with_the_thrusters_is_not_taken_for_a_current(tank: Callable[..., Tank]) -> None:
    flight = tank()
    flight.run(_flies, 60.0)
    flight.pilot_mode(0)
    flight.run(lambda _: flight.said("Pilot has taken over"), 0.1)
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
