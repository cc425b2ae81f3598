"""Thrust to pulses: inverse of the forward curve, monotone, within range, deadband jumped."""

import math

import numpy as np
import pytest
from control_loop import VEHICLE
from hypothesis import given
from hypothesis import strategies as st

from autopilot.control.thrust.allocation import Allocation
from autopilot.core.thrust_law import law_of
from autopilot.core.vehicle import load_vehicle

ALLOCATION = Allocation(VEHICLE.thrusters)
DRIVE = VEHICLE.drive
supply = st.floats(14.0, 20.0)
request = st.floats(-15.0, 15.0)


@given(request, supply)
def test_pulse_is_in_range_and_thrust_within_the_limit(thrust_n: float, supply_v: float) -> None:
    pulse = ALLOCATION.pulse_us(0, thrust_n, supply_v)
    assert isinstance(pulse, int)
    assert abs(pulse - DRIVE.neutral_us) <= DRIVE.span_us
    realised = ALLOCATION.thrust_n(0, pulse, supply_v)
    assert abs(realised) <= DRIVE.limit_n
    assert realised * thrust_n >= 0.0


@given(request, request, supply)
def test_monotone(one: float, other: float, supply_v: float) -> None:
    low, high = sorted((one, other))
    assert ALLOCATION.pulse_us(0, low, supply_v) <= ALLOCATION.pulse_us(0, high, supply_v)


@given(request, supply)
def test_inverse_of_the_forward_curve(thrust_n: float, supply_v: float) -> None:
    pulse = ALLOCATION.pulse_us(0, thrust_n, supply_v)
    offset = abs(pulse - DRIVE.neutral_us)
    wanted = math.copysign(min(abs(thrust_n), DRIVE.limit_n), thrust_n)
    realised = ALLOCATION.thrust_n(0, pulse, supply_v)
    if offset == 0:
        edge = ALLOCATION.thrust_n(0, DRIVE.neutral_us + 27, supply_v)
        assert abs(wanted) < 0.5 * edge + 1e-9
    elif offset == 27:
        assert abs(wanted) <= ALLOCATION.thrust_n(0, DRIVE.neutral_us + 28, supply_v)
    elif offset < DRIVE.span_us:
        coefficient = DRIVE.brushed_law[1] if thrust_n > 0 else DRIVE.brushed_law[2]
        one_us = coefficient * (supply_v / DRIVE.span_us) ** 2 * (2 * offset + 1)
        assert abs(realised - wanted) <= one_us
    else:
        assert abs(realised) <= abs(wanted) + 0.1


@given(st.integers(1100, 1900), supply)
def test_round_trip_of_pulses(pulse: int, supply_v: float) -> None:
    thrust = ALLOCATION.thrust_n(0, pulse, supply_v)
    if abs(thrust) <= DRIVE.limit_n:
        back = ALLOCATION.pulse_us(0, thrust, supply_v)
        assert back == (pulse if thrust else DRIVE.neutral_us)


def test_deadband_is_jumped_from_half_the_smallest_thrust() -> None:
    smallest = ALLOCATION.thrust_n(0, 1527)
    assert smallest > 0.0
    assert ALLOCATION.thrust_n(0, 1526) == 0.0
    assert ALLOCATION.pulse_us(0, 0.51 * smallest) == 1527
    assert ALLOCATION.pulse_us(0, 0.49 * smallest) == 1500
    assert ALLOCATION.pulse_us(0, -0.51 * ALLOCATION.thrust_n(0, 1527)) in (1473, 1500)


def test_sagging_supply_saturates_and_lowers_the_capability() -> None:
    assert ALLOCATION.pulse_us(0, -12.0, 15.0) == 1100
    assert ALLOCATION.capability_n(15.0) == pytest.approx([0.03457 * 225.0] * 4)
    assert ALLOCATION.capability_n(19.0).tolist() == [12.0] * 4


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_not_a_number_is_neutral(bad: float) -> None:
    assert ALLOCATION.pulse_us(0, bad) == 1500
    assert ALLOCATION.pulse_us(0, 5.0, bad) == ALLOCATION.pulse_us(0, 5.0)
    assert ALLOCATION.pulse_us(0, 5.0, None) == ALLOCATION.pulse_us(0, 5.0, 0.0)


def test_arrays_and_neutral() -> None:
    pulses = ALLOCATION.pulses_us(np.array([3.0, -3.0, 0.0, 12.0]))
    assert len(pulses) == 4
    assert pulses[2] == 1500
    assert np.allclose(ALLOCATION.thrusts_n(pulses), [3.0, -3.0, 0.0, 12.0], atol=0.06)
    assert ALLOCATION.neutral_us == (1500,) * 4


@pytest.mark.parametrize("name", ["lbv150", "bluerov2"])
def test_a_request_below_half_of_the_smallest_thrust_turns_nothing(name: str) -> None:
    """Either kind of drive, either way."""
    thruster = load_vehicle(name).thrusters[0]
    law = law_of(thruster.drive)
    for sign in (1, -1):
        edge = next(offset for offset in range(1, 400) if law.thrust_n(sign * offset, None) != 0.0)
        smallest_n = law.thrust_n(sign * edge, None)
        assert law.offset_us(0.45 * smallest_n, thruster.limit_n, None) == 0
        assert law.offset_us(1e-6 * sign, thruster.limit_n, None) == 0
        assert law.offset_us(0.55 * smallest_n, thruster.limit_n, None) == sign * edge
