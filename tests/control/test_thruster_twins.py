"""Thrusters that do the same: one of them lost, named alone where the tilt says which, else with its twins."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vehicles import bluerov2, drawn

from autopilot.control.thrust.actuation import Actuation
from autopilot.control.thrust.redundancy import alike, lossy_effectiveness, tilt_of, weak_thrusters
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import Model4
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.sitl.plant import Plant
from autopilot.sitl.simulated_waters import SimulatedWaters
from tests.bench.energy.flight import nav_state

SHIPPED = {name: load_vehicle(name) for name in ("lbv150", "bluerov2", "bluerov2-heavy")}
TICK_US, LOST_S = 20_000, 8.0


@dataclass
class Said:
    """What was said of the thrusters of a flight."""

    named: set[frozenset[int]] = field(default_factory=set)
    """Every set of thrusters that ever gave less than all at the same time."""
    first_s: float = math.inf
    """When the first did."""
    doubtful: tuple[tuple[str, ...], ...] = ()
    """At the end."""
    effectiveness: FloatArray = field(default_factory=lambda: np.zeros(0))
    limit_n: FloatArray = field(default_factory=lambda: np.zeros(0))
    heave_n: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Per tick: what was wanted and what the thrusters gave of it."""


def manoeuvre(
    vehicle: Vehicle,
    lost: int | None,
    seconds: float,
    *,
    seed: int = 0,
    left: float = 0.0,
    gain: float = 1.0,
    tell: tuple[float, str, float] | None = None,
) -> Said:
    """The thrusters as the service has them under the simulated vehicle, pushed along all axes; one is lost at LOST_S.
    ``tell``: a parameter that an operator sets at a time [s]."""
    params, allocator = ParamSet(), ControlAllocator.of(vehicle)
    actuation = Actuation(vehicle, params)
    plant = Plant(vehicle, SimulatedWaters(), start_pos_ned_m=(0.0, 0.0, 30.0), mismatch={"thrust": gain})
    rng, said, n = np.random.default_rng(seed), Said(), len(vehicle.thrusters)
    phase = rng.uniform(0.0, 2.0 * math.pi, 4)
    thrust, effect = np.zeros(n), np.array(vehicle.to_model().allocation)[2]
    most_n = 4.0 * float(np.abs(effect).sum())
    heave = []
    for tick in range(round(seconds * 1e6 / TICK_US)):
        t_us, t_s = tick * TICK_US, tick * TICK_US * 1e-6
        if lost is not None and t_s == LOST_S:
            plant.set_thruster_loss(vehicle.thrusters[lost].name, 1.0 - left)
        if tell is not None and t_s == tell[0]:
            params.set(tell[1], tell[2])
        truth = plant.truth
        nav = replace(
            nav_state(truth),
            variance=np.full(12, 1e-4),
            vel_frd_m_s=truth.vel_frd_m_s + rng.normal(0.0, 0.005, 3),
            rate_frd_rad_s=truth.rate_frd_rad_s + rng.normal(0.0, 0.006, 3),
        )
        actuation.learn(t_us, nav, actuation.send(t_us), None, armed=True, reached=True)
        weak = frozenset(np.flatnonzero(actuation.losses.effectiveness < 1.0).tolist())
        if weak:
            said.named.add(weak)
            said.first_s = min(said.first_s, t_s)
        if tick % 3 == 0:
            # Back to the depth, as whoever steers would.
            down = 2.0 + 6.0 * (30.0 - truth.pos_ned_m[2]) + most_n * math.copysign(1.0, math.sin(1.6 * t_s + phase[2]))
            ahead, aside = 5.0 * math.sin(t_s + phase[0]), 5.0 * math.sin(1.4 * t_s + phase[1])
            wanted = np.array([ahead, aside, down, 0.5 * math.sin(1.8 * t_s + phase[3])])
            thrust = allocator.thrust_n(wanted, actuation.limit_n)
        command = actuation.command(t_us, thrust, armed=True)
        pulses = command.pwm_us[:n]
        gives = np.ones(n)
        if lost is not None and t_s >= LOST_S:
            gives[lost] = left
        heave.append((effect @ command.thrust_n[:n], effect @ (gives * actuation.allocation.thrusts_n(pulses))))
        plant.advance(t_us + TICK_US, pulses)
    said.doubtful, said.effectiveness, said.limit_n = (
        actuation.losses.doubtful,
        actuation.losses.effectiveness,
        actuation.limit_n,
    )
    said.heave_n = np.array(heave)
    return said


@pytest.mark.parametrize(
    ("name", "lost"), [(name, i) for name, vehicle in SHIPPED.items() for i in range(len(vehicle.thrusters))]
)
def test_a_dead_thruster_is_named_alone_or_with_its_twins_and_never_a_sound_one(name: str, lost: int) -> None:
    """All thrusters of all vehicle files."""
    vehicle = SHIPPED[name]
    said = manoeuvre(vehicle, lost, 21.0, seed=lost)
    redundant = set(np.flatnonzero(alike(vehicle.to_model())[lost]).tolist())
    assert LOST_S < said.first_s < LOST_S + 12.0
    assert all(lost in named and named <= redundant for named in said.named)


@pytest.mark.parametrize("name", list(SHIPPED))
def test_sound_twins_are_not_blamed(name: str) -> None:
    assert manoeuvre(SHIPPED[name], None, 20.0, gain=0.8).named == set()


@pytest.mark.parametrize("lost", [4, 5])
def test_which_vertical_of_a_bluerov2_is_dead_shows_in_its_roll(lost: int) -> None:
    """Within 16 s by six of eight seeds of the noise, within 26 s by all."""
    said = manoeuvre(SHIPPED["bluerov2"], lost, 26.0, seed=lost)
    assert np.flatnonzero(said.effectiveness < 1.0).tolist() == [lost]
    assert said.doubtful == ()


@pytest.mark.parametrize("lost", [4, 5])
def test_where_nothing_tells_them_apart_both_are_named_and_heave_is_right_whichever_it_is(lost: int) -> None:
    """Two verticals in the same place: the motion is the same whichever is dead."""
    vehicle = bluerov2()
    said = manoeuvre(vehicle, lost, 18.0)
    assert said.named == {frozenset({4, 5})}
    assert said.doubtful == (("t5", "t6"),)
    assert said.effectiveness[4] == said.effectiveness[5]
    assert lossy_effectiveness(said.effectiveness[4:].tolist()) < 0.35
    # The one that is left is asked for all of it, and for no more than it can give.
    able_n = Actuation(vehicle, ParamSet()).allocation.capability_n(None)
    assert said.limit_n[4:].sum() < 1.35 * able_n[4]
    wanted, given_n = said.heave_n[-100:].T
    assert np.abs(wanted - given_n).mean() < 0.35 * np.abs(wanted).mean()
    before, gave = said.heave_n[round((LOST_S + 0.5) * 1e6 / TICK_US) :][:50].T
    assert np.abs(before - gave).mean() > 0.4 * np.abs(before).mean()


def test_what_an_operator_tells_of_one_of_them_stands_for_it() -> None:
    """The other one is sound then."""
    assert manoeuvre(bluerov2(), 4, 14.0).doubtful
    said = manoeuvre(bluerov2(), 4, 14.5, tell=(14.0, "THR5_HEALTH", 0.0))
    assert said.effectiveness.tolist() == [1.0, 1.0, 1.0, 1.0, 0.0, 1.0]
    assert said.doubtful == ()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 8), st.floats(0.0, 0.6))
def test_twins_are_those_that_push_the_same_way_or_the_opposite(seed: int, thrusters: int, turned: float) -> None:
    rng = np.random.default_rng(seed)
    model = drawn(rng, thrusters).to_model()
    columns = np.array(model.allocation)
    for sign in (1.0, -1.0):
        more = np.column_stack([columns, sign * columns[:, 0]])
        redundant = alike(with_columns(model, more))
        assert redundant[0, thrusters] and (redundant == redundant.T).all() and redundant.diagonal().all()
    other = np.array([0.0, 0.0, 1.0, 0.0]), np.array([math.sin(turned), 0.0, math.cos(turned), 0.0])
    aside = alike(with_columns(replace(model, mass_kg=(20.0, 20.0, 20.0, 0.3)), np.column_stack(other)))
    assert abs(turned - 0.2) < 0.01 or bool(aside[0, 1]) is (math.sin(turned) < 0.2)


def with_columns(model: Model4, columns: FloatArray) -> Model4:
    return replace(model, allocation=tuple(tuple(row) for row in columns.tolist()))


def test_arms_about_roll_and_pitch_come_from_the_places_of_the_thrusters() -> None:
    tilt = tilt_of(SHIPPED["bluerov2-heavy"])[:, 4:]
    front, starboard = np.array([1, 1, -1, -1]), np.array([1, -1, 1, -1])
    assert (np.sign(tilt[0]) == starboard).all()
    assert (np.sign(tilt[1]) == -front).all()


def test_texts_name_thrusters_alone_or_together() -> None:
    names, shares = ("a", "b", "c", "d"), (1.0, 0.5, 0.55, 0.55)
    assert weak_thrusters(names, shares, ()) == ["b 50 %", "c 55 %", "d 55 %"]
    assert weak_thrusters(names, shares, (("c", "d"),)) == ["b 50 %", "one of c, d 10 %"]
