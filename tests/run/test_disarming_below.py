"""What an operator disarms is disarmed below: every state of ours x state of the flight controller x command.

The oracle is the emulated flight controller itself: when a command is answered ACCEPTED, it is disarmed.
"""

from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ardusub_tank import Tank, tanks

from autopilot.command.disarming import CONFIRM_US
from autopilot.core.clock import TICK_US
from autopilot.core.messages import MavlinkFrame, Outputs
from autopilot.core.operator_messages import DISARM_NOT_CONFIRMED, FOUND_ARMED
from autopilot.drivers.ardusub import ARMED
from autopilot.mavlink.api import CommandResult, FlightMode

CONFIRM_TICKS = CONFIRM_US // TICK_US
DISARM, FORCED, TERMINATE = (400, 0.0, 0.0), (400, 0.0, 21196.0), (185, 1.0, 0.0)
COMMANDS = {"disarm": DISARM, "forced": FORCED, "terminate": TERMINATE}
ARMED_FLAG = 128
ACCEPTED, FAILED = CommandResult.ACCEPTED, CommandResult.FAILED
IN_PROGRESS = CommandResult.IN_PROGRESS


class Watched(Tank):
    """With what the service answers, and how its flight controller stood at that moment."""

    def __init__(self, folder: Path, **parameters: float) -> None:
        self.answers: list[tuple[int, bool]] = []
        """Results, and whether the flight controller was armed then."""
        self.shown_armed = False
        super().__init__(folder, operator=False, **parameters)
        self._reader: Any = self.below.codec(1, 1)

    def _tick(self, outputs: Outputs) -> None:
        for frame in outputs.mavlink_tx:
            self._read(frame)
        super()._tick(outputs)

    def _read(self, frame: MavlinkFrame) -> None:
        for message in self._reader.parse_buffer(frame.data) or ():
            if message.get_type() == "COMMAND_ACK" and message.command in (185, 400):
                self.answers.append((message.result, self.below.armed))
            elif message.get_type() == "HEARTBEAT":
                self.shown_armed = bool(message.base_mode & ARMED_FLAG)

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self._t_us += 10_000
            self.session.runtime.tick(self._t_us)

    def ask(self, command: int, *params: float) -> None:
        self.answers.clear()
        given = [*params, *[0.0] * (7 - len(params))]
        self.order(self._pilot.command_long_encode(1, 1, command, 0, *given))

    def answered(self) -> tuple[int, bool]:
        """The final answer, counted in ticks."""
        for _ in range(CONFIRM_TICKS + 20):
            self.tick()
            final = [answer for answer in self.answers if answer[0] != IN_PROGRESS]
            if final:
                return final[-1]
        pytest.fail(f"no answer: {self.answers}")

    def arms_below(self, armed: bool) -> None:
        """By another ground station."""
        self.pilot(self._pilot.command_long_encode(1, 1, 400, 0, float(armed), 21196, 0, 0, 0, 0, 0))

    def fly(self) -> None:
        for _ in range(600):
            if not self.session.parts.commander.prearm_reasons():
                break
            self.tick(10)
        self.ask(400, 1.0, 0.0)
        self.run(lambda _: self.below.armed, 5.0)
        self.tick(120)
        assert self.session.parts.commander.armed


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Callable[..., Watched]]:
    with tanks(Watched, tmp_path) as made:
        yield made


def _prepare(tank: Watched, ours: str, below: str) -> None:
    """Bring both sides into a state."""
    commander = tank.session.parts.commander
    tank.pilot_mode(19)
    if ours in ("armed", "motor test", "failsafe"):
        tank.fly()
    if ours == "motor test":
        tank.ask(176, 1.0, 1.0)
        tank.run(lambda _: commander.mode is FlightMode.MANUAL, 1.0)
        tank.ask(209, 1.0, 0.0, 10.0, 2.0)
        tank.tick(5)
    elif ours == "failsafe":
        tank.session.parts.params.set("FS_BATT_LOW", 1.0)
        tank.run(lambda outputs: outputs.mode.failsafes != 0, 5.0)
    if below == "armed":
        tank.arms_below(True)
    elif below == "armed, pilot's":
        tank.arms_below(True)
        tank.pilot_mode(0)
    elif below == "disarmed":
        tank.arms_below(False)
    if ours == "disarmed":
        tank.tick(120)


@pytest.mark.parametrize("ours", ["disarmed", "armed", "motor test", "failsafe"])
def test_what_an_operator_disarms_is_disarmed_below_before_it_is_accepted(
    make: Callable[..., Watched], ours: str
) -> None:
    tank, states = make(FS_BATT_ACT=1.0), ("armed", "armed, pilot's", "disarmed")
    for below, name in product(states, COMMANDS) if ours == "disarmed" else zip(states, COMMANDS, strict=True):
        _prepare(tank, ours, below)
        tank.ask(*COMMANDS[name])
        assert tank.answered() == (ACCEPTED, False), (below, name)
        tank.tick(150)
        assert not tank.below.armed and not tank.session.parts.commander.armed, (below, name)
        assert not tank.shown_armed
        tank.session.parts.params.set("FS_BATT_LOW", 0.1)


@pytest.mark.parametrize(("ours", "wire"), [("disarmed", "mute"), ("armed", "deaf"), ("armed", "cut")])
def test_what_is_not_confirmed_is_said_to_have_failed_and_is_asked_for_until_it_is(
    make: Callable[..., Watched], ours: str, wire: str
) -> None:
    tank = make()
    tank.tick(300)
    _prepare(tank, ours, "armed")
    tank.deaf, tank.unheard = wire in ("deaf", "cut"), wire in ("mute", "cut")
    tank.tick(60)
    tank.ask(*DISARM)
    result, _ = tank.answered()
    assert result == FAILED
    assert IN_PROGRESS in {answer for answer, _ in tank.answers}
    assert tank.reported(DISARM_NOT_CONFIRMED.template)
    assert not tank.session.parts.commander.armed
    tank.deaf = tank.unheard = False
    tank.run(lambda _: tank.reported("Flight controller is disarmed now"), 5.0)
    assert not tank.below.armed
    tank.tick(150)
    assert not tank.shown_armed


def test_a_request_or_an_answer_that_is_lost_is_made_up_for(make: Callable[..., Watched]) -> None:
    tank = make()
    tank.fly()
    for way, lost in (("deaf", 12), ("unheard", 1)):
        setattr(tank, way, True)
        tank.ask(*FORCED)
        tank.tick(10 * lost)
        assert not [answer for answer, _ in tank.answers if answer == ACCEPTED] or not tank.below.armed
        setattr(tank, way, False)
        assert tank.answered() == (ACCEPTED, False)
        tank.fly()


def test_an_arming_that_comes_before_the_disarming_is_confirmed_is_put_off(make: Callable[..., Watched]) -> None:
    tank = make()
    tank.fly()
    tank.ask(*DISARM)
    tank.tick(1)
    tank.ask(400, 1.0, 0.0)
    tank.tick(2)
    assert [answer for answer, _ in tank.answers] == [CommandResult.TEMPORARILY_REJECTED]
    tank.tick(50)
    assert not tank.below.armed and not tank.reported("disarmed by pilot"), "it was us"
    tank.fly()


def test_on_the_very_first_tick_nothing_is_accepted_that_is_not_known(make: Callable[..., Watched]) -> None:
    tank = make()
    tank.below._arm(0)
    tank.ask(*DISARM)
    assert tank.answered() == (ACCEPTED, False)


def test_what_is_found_armed_is_said_and_shown_and_can_be_disarmed(make: Callable[..., Watched]) -> None:
    """A service that died armed is started again."""
    tank = make()
    tank.below._arm(0)
    tank.run(lambda _: tank.reported(FOUND_ARMED.template), 3.0)
    tank.tick(300)
    commander = tank.session.parts.commander
    assert ARMED in commander.prearm_reasons()
    assert tank.shown_armed and not commander.armed
    assert tank.below.armed  # perhaps a pilot flies it: that is for the operator to say
    tank.ask(400, 1.0, 0.0)
    tank.tick(5)
    assert [answer for answer, _ in tank.answers] == [CommandResult.DENIED]
    tank.ask(*FORCED)
    assert tank.answered() == (ACCEPTED, False)
    tank.tick(150)
    assert not tank.shown_armed and ARMED not in commander.prearm_reasons()


@pytest.mark.parametrize(
    ("state", "left_armed"),
    [("flown", False), ("found", False), ("lost answers", False), ("pilot's mode", True), ("pilot armed it", True)],
)
def test_a_run_that_ends_disarms_what_is_ours(make: Callable[..., Watched], state: str, left_armed: bool) -> None:
    tank = make()
    if state == "found":
        tank.below._arm(0)
    tank.tick(300)
    if state in ("flown", "lost answers"):
        tank.fly()
    elif state != "found":
        tank.arms_below(True)
        tank.pilot_mode(0 if state == "pilot's mode" else 19)
        tank.tick(150)
    assert tank.below.armed
    runtime, device = tank.session.runtime, tank.session.runtime._stopped_by
    assert device is not None
    stand_down, waited = device.stand_down, [0]

    def with_the_world(t_us: int) -> bool:
        waited[0] += 1
        tank.unheard = state == "lost answers" and waited[0] < 60
        done = stand_down(t_us)
        tank.world_goes_on(t_us)
        return done

    device.stand_down = with_the_world  # type: ignore[method-assign]
    runtime._stand_down(tank._t_us // 10_000)
    assert tank.below.armed is left_armed
    if not left_armed:
        assert waited[0] > 1  # it waited for the heartbeat


@pytest.mark.parametrize("lost", [0, CONFIRM_TICKS + 10])
def test_a_failsafe_that_disarms_is_not_content_with_asking(make: Callable[..., Watched], lost: int) -> None:
    tank = make(FS_SENDER_ACT=4.0)
    tank.fly()
    tank.below._read_us += 10_000

    def beside(outputs: Outputs) -> bool:
        tank.stick(600 if outputs.t_us % 50_000 == 0 else 0)
        return not outputs.mode.armed

    tank.run(beside, 2.0)
    tank.deaf = True
    tank.tick(lost)
    assert tank.below.armed
    tank.deaf = False
    tank.tick(120)
    assert not tank.below.armed and not tank.shown_armed
    assert tank.reported(DISARM_NOT_CONFIRMED.template) == (lost > CONFIRM_TICKS)


def test_a_second_sender_is_told_and_acted_on_and_nothing_else_is_blamed(make: Callable[..., Watched]) -> None:
    tank, hz = make(), 25
    tank.fly()
    tank.tick(100)
    count, began_us = len(tank.texts), tank._t_us
    tank.below._read_us += 10_000  # it reads its channels between our commands, or the other's would never be read
    rng, next_us = np.random.default_rng(hz), [tank._t_us]

    def beside(outputs: Outputs) -> bool:
        if outputs.t_us >= next_us[0]:  # no clock of two machines keeps its phase
            next_us[0] += round(1e6 / hz) + 10_000 * int(rng.integers(-1, 2))
            tank.stick(-700)
        return outputs.t_us >= began_us + 4_000_000

    tank.run(beside, 5.0)
    said = tank.texts[count:]
    noticed = [t_s for t_s, text in said if "another sender on the thrusters" in text]
    assert noticed and noticed[0] - 1e-6 * began_us <= 0.35  # of simulated time: fifteen reports, and the ticks there
    assert not [text for _, text in said if "late" in text or "wrong" in text or "Surfac" in text], said
    assert tank.session.parts.commander.mode is FlightMode.HOLD
    tank.run(lambda _: tank.reported("Failsafe over: another sender"), 3.0)


@pytest.mark.parametrize(("protocols", "lasts_s"), [(0.0, 3.0), (1.0, 3.0), (1.0, -1.0)])
def test_a_service_that_dies_leaves_neutral_thrusters_where_arming_is_allowed(
    make: Callable[..., Watched], protocols: float, lasts_s: float
) -> None:
    """The promise and what arming depends on are the same: what keeps the thrust refuses arming."""
    tank = make()
    tank.below.parameters |= {"RC_PROTOCOLS": protocols, "RC_OVERRIDE_TIME": lasts_s}
    tank.tick(400)
    refused = [text for text in tank.session.parts.commander.prearm_reasons() if "RC_" in text]
    if not refused:
        tank.fly()
    tank.below._arm(tank._t_us)
    tank.below.receive(
        tank._t_us, bytes(tank._pilot.rc_channels_override_encode(1, 1, *[1600] * 6, 65535, 65535).pack(tank._pilot))
    )
    for _ in range(60):  # the world goes on without the service
        tank._t_us += 10_000
        tank.world.advance(tank._t_us)
    stands = any(pulse != 1500 for pulse in tank.below.servos_us)
    tank.tick()
    assert stands == bool(refused)
