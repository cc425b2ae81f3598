"""Late commands: how late they are found to act, no false alarms, and flying with them once it is known."""

import math

import numpy as np
import pytest
from control_loop import MODEL, STEP_US, TANK, VEHICLE, A, nav_state, rk4, still

from autopilot.control.controller import MotionController
from autopilot.control.nmpc.lag import ThrusterLag
from autopilot.control.thrust.actuation_delay import LONGEST_DOUBT_S, ActuationDelay, CommandDelay
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Fallback, NavHealth
from autopilot.core.model4 import Model4
from autopilot.core.params import ParamSet
from autopilot.core.response import Response

LAG_S = VEHICLE.drive.time_constant_s
CURRENT = np.array([0.15, -0.1, 0.0])
DT_S = 0.02


def _thrust(t_s: float) -> FloatArray:
    """Rest for a second, then cruise with turns, side steps and depth changes, as missions have them."""
    if t_s < 1.0:
        return np.zeros(4)
    surge, turn = 3.0 + math.sin(1.0 * t_s), 1.2 * math.sin(1.8 * t_s)
    heave = 0.6 + (2.0 if math.sin(1.6 * t_s) > 0.0 else -2.0)
    return np.array([surge + turn, surge - turn, heave, 3.0 * math.sin(1.4 * t_s)])


class Line:
    """A vehicle at the end of a line that may be late, and the estimator beside it."""

    def __init__(self, plant: Model4 = MODEL, lag_s: float = LAG_S) -> None:
        self.found = ActuationDelay(MODEL, Response([LAG_S] * 4))
        self.plant, self.lag_s = plant, lag_s
        self.rng = np.random.default_rng(1)
        self.x, self.acting, self.t_s = np.zeros(8), np.zeros(4), 0.0
        self.doubted_s: list[float] = []
        self.declared: list[tuple[float, float]] = []

    def fly(self, seconds: float, delay_s: float = 0.0, gain: FloatArray | None = None) -> None:
        for _ in range(round(seconds / DT_S)):
            thrust = _thrust(self.t_s - delay_s) * (1.0 if gain is None else gain)
            self.acting += (1.0 - math.exp(-DT_S / self.lag_s)) * (thrust - self.acting)
            self.x = rk4(self.plant, self.x, self.acting, lambda _: CURRENT, DT_S)
            nav = nav_state(round(self.t_s * 1e6), self._seen(), self._believed())
            self.t_s += DT_S
            if self.found.step(round(self.t_s * 1e6), nav, _thrust(self.t_s - DT_S)):
                self.declared.append((self.t_s, self.found.delay_s))
            if self.found.doubtful:
                self.doubted_s.append(self.t_s)

    def _seen(self) -> FloatArray:
        """Over ground (no water in between for the estimator), with the noise of an estimate."""
        x: FloatArray = self.x.copy()
        c, s = math.cos(x[3]), math.sin(x[3])
        x[4] += c * CURRENT[0] + s * CURRENT[1]
        x[5] += c * CURRENT[1] - s * CURRENT[0]
        x[4:7] += self.rng.normal(0.0, 0.005, 3)
        x[7] += self.rng.normal(0.0, 0.006)
        return x

    def _believed(self) -> FloatArray:
        wander = np.array([0.05 * math.sin(0.2 * self.t_s), 0.05 * math.cos(0.3 * self.t_s), 0.0])
        believed: FloatArray = CURRENT + wander
        return believed


def _off(mass: float, drag: float, thrust: float) -> Model4:
    return Model4(
        mass_kg=tuple(mass * m for m in MODEL.mass_kg),  # type: ignore[arg-type]
        linear_drag=tuple(drag * d for d in MODEL.linear_drag),  # type: ignore[arg-type]
        quadratic_drag=tuple(drag * d for d in MODEL.quadratic_drag),  # type: ignore[arg-type]
        buoyancy_excess_n=MODEL.buoyancy_excess_n - 1.0,
        allocation=tuple((thrust * a, thrust * b, thrust * c, thrust * d) for a, b, c, d in MODEL.allocation),
    )


@pytest.mark.parametrize(
    ("delay_s", "heavy", "within_s"),
    [(0.5, False, 1.4), (0.75, False, 1.8), (1.0, False, 0.8), (1.4, False, 0.8), (0.75, True, 2.5), (1.0, True, 2.0)],
)
def test_late_commands_are_doubted_at_once_and_measured_when_they_act(
    delay_s: float, heavy: bool, within_s: float
) -> None:
    line = Line(_off(1.2, 1.3, 0.9) if heavy else MODEL)
    line.fly(1.0 + delay_s + within_s, delay_s)
    assert line.doubted_s[0] < 1.0 + 0.8
    assert line.declared[-1][1] == pytest.approx(delay_s, abs=0.1)


@pytest.mark.parametrize(
    ("mass", "drag", "thrust", "lag_s"), [(1.2, 1.3, 0.9, 0.25), (0.8, 0.7, 1.1, 0.1), (1.2, 0.7, 1.1, 0.25)]
)
def test_errors_of_the_model_are_no_delay(mass: float, drag: float, thrust: float, lag_s: float) -> None:
    line = Line(_off(mass, drag, thrust), lag_s)
    line.fly(15.0)
    assert (line.declared, line.doubted_s) == ([], [])
    assert line.found.probability[:3].sum() > 0.9


@pytest.mark.parametrize("thruster", range(4))
def test_a_dead_thruster_is_no_delay(thruster: int) -> None:
    gain = np.ones(4)
    gain[thruster] = 0.0
    line = Line()
    line.fly(4.0)
    line.fly(10.0, gain=gain)
    assert line.declared == []


def test_a_line_that_becomes_late_and_prompt_again() -> None:
    line = Line()
    line.fly(8.0)
    line.fly(15.0, 0.8)
    assert line.found.delay_s == pytest.approx(0.8, abs=0.1)
    line.fly(15.0)
    assert line.found.delay_s == 0.0
    assert not line.found.doubtful


def test_without_thrust_or_estimate_nothing_is_concluded() -> None:
    delay = ActuationDelay(MODEL, Response([LAG_S] * 4))
    for tick in range(500):
        nav = nav_state(tick * 20_000, np.zeros(8), health=NavHealth.DEAD_RECKONING)
        assert not delay.step(tick * 20_000, nav if tick % 2 else None, np.full(4, 5.0))
    assert delay.probability == pytest.approx(1.0 / 16.0)
    delay.reset()
    for tick in range(500, 1000):
        delay.step(tick * 20_000, nav_state(tick * 20_000, np.zeros(8)), np.zeros(4))
    assert not delay.doubtful


def test_thrusters_that_never_respond_are_doubted_for_a_while_only() -> None:
    care = CommandDelay(VEHICLE, ParamSet())
    thrust, doubted_us = np.array([4.0, 4.0, 1.0, 2.0]), 0
    for tick in range(1500):
        t_us = tick * 10_000
        care.send(t_us, np.zeros(4) if care.doubtful or tick < 100 else thrust)
        care.step(t_us, nav_state(t_us, np.zeros(8)), armed=True)
        doubted_us += 10_000 * care.doubtful
    assert 0 < doubted_us <= LONGEST_DOUBT_S * 1e6
    assert care.delay_s == 0.0
    assert not care.doubtful


def test_pulses_under_way_reach_estimator_and_thrusters_when_they_act() -> None:
    care, line, off = CommandDelay(VEHICLE, ParamSet()), Line(), CommandDelay(VEHICLE, ParamSet({"LAT_DETECT": 0}))
    acting, thrusts = [], []
    for tick in range(500):
        t_us, thrust = tick * 10_000, _thrust(tick * 0.01)
        thrusts.append(thrust)
        acting.append(care.send(t_us, thrust))
        assert off.send(t_us, thrust) is thrust
        line.acting += (1.0 - math.exp(-0.01 / LAG_S)) * (_thrust(tick * 0.01 - 1.0) - line.acting)
        line.x = rk4(MODEL, line.x, line.acting, still, 0.01)
        care.step(t_us, nav_state(t_us, line.x), armed=True)
        off.step(t_us, nav_state(t_us, line.x), armed=True)
    assert care.delay_s == pytest.approx(1.0, abs=0.07)
    assert not care.prompt
    assert (acting[-1] == thrusts[-1 - math.ceil(care.delay_s * 100)]).all()
    assert acting[130].tolist() == thrusts[130].tolist()
    assert off.prompt
    # The estimator's current of these seconds is not believed at once.
    nav = nav_state(5_000_000, line.x, np.array([-0.4, 0.2, 0.0]))
    believed = care.nav_for_control(5_000_000, nav)
    assert believed.current_ned_m_s == pytest.approx([0.0, 0.0, 0.0])
    assert believed.vel_water_frd_m_s == pytest.approx(nav.vel_frd_m_s)
    assert care.nav_for_control(15_000_000, nav) is nav
    care.step(5_010_000, None, armed=False)
    assert care.nav_for_control(5_010_000, nav) is nav
    assert care.prompt


def test_the_prediction_goes_through_what_is_under_way_and_learns_what_it_misses() -> None:
    lag, rng = ThrusterLag(MODEL, Response([LAG_S] * 4)), np.random.default_rng(4)
    lag.act_late(0.6)
    pushed = Model4(
        mass_kg=MODEL.mass_kg,
        linear_drag=MODEL.linear_drag,
        quadratic_drag=MODEL.quadratic_drag,
        buoyancy_excess_n=MODEL.buoyancy_excess_n + 1.5,
        allocation=MODEL.allocation,
    )
    x, acting, sent, seen = np.zeros(8), np.zeros(4), [np.zeros(4)] * 60, []
    for tick in range(1500):
        command = sent[-1] if tick % 10 else np.clip(rng.normal(0.0, 2.0, 4) - 0.5 * sent[-1], -4.0, 4.0)
        seen.append((x.copy(), lag.ahead(x, np.zeros(3))))
        sent.append(command)
        lag.follow(command, 0.01)
        acting += (1.0 - math.exp(-0.01 / LAG_S)) * (sent[-61] - acting)
        x = rk4(pushed if tick > 500 else MODEL, x, acting, still, 0.01)
    assert lag.acting_n == pytest.approx(acting, abs=1e-9)
    # One lag and the delay: what acts at the end of the delay is kept for the lag (within what that is worth).
    errors = np.array([seen[i + 75][0] - seen[i][1] for i in range(0, 400, 10)])
    assert np.abs(errors[:, :3]).max() < 0.03
    heave = (
        [float(seen[i + 75][0][6] - seen[i][1][6]) for i in range(502, 520)],
        [float(seen[i + 75][0][6] - seen[i][1][6]) for i in range(1200, 1400)],
    )
    assert abs(np.mean(heave[1])) < 0.4 * abs(np.mean(heave[0]))


def _hold(known_s: float, seconds: float) -> FloatArray:
    """Distances from A (n,) of a vehicle that holds there, disturbed, with commands that act a second late."""
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet()
    x, acting, under_way, away = np.zeros(8), np.zeros(4), [np.zeros(4)] * 100, []
    x[:4] = [*(A.pos_ned_m + np.array([0.1, 0.1, 0.0])), 0.3]
    plant = _off(1.1, 1.2, 0.95)
    for step in range(round(seconds * 20)):
        t_us = step * STEP_US
        out = controller.step(t_us, nav_state(t_us, x), A, TANK, params, delay_s=known_s)
        for _ in range(5):
            under_way.append(out.thrust_n)
            acting += (1.0 - math.exp(-0.01 / LAG_S)) * (under_way.pop(0) - acting)
            x = rk4(plant, x, acting, still, 0.01)
        away.append(math.hypot(*(x[:2] - A.pos_ned_m[:2])) + abs(x[3]))
    return np.array(away)


def test_a_known_delay_is_flown_with_and_an_unknown_one_is_not() -> None:
    known, unknown = _hold(1.0, 14.0), _hold(0.0, 8.0)
    assert known[-100:].max() < 0.1
    assert unknown[-100:].max() > 10.0 * known[-100:].max()


def test_in_doubt_nothing_is_commanded() -> None:
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    x = np.array([-1.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert controller.step(0, nav_state(0, x), A, TANK, ParamSet()).thrust_n.any()
    out = controller.step(STEP_US, nav_state(STEP_US, x), A, TANK, ParamSet(), delay_s=None)
    assert not out.thrust_n.any()
    assert out.status.fallback is Fallback.NEUTRAL
    assert controller.tick(STEP_US + 10_000, nav_state(STEP_US, x)) is None
    assert controller.step(2 * STEP_US, nav_state(2 * STEP_US, x), A, TANK, ParamSet()).status.fallback is Fallback.NONE
