"""Thrusters of any drive on any channel: what the service sends the plant gives, though each has its own code."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.control.thrust.allocation import Allocation
from autopilot.core.thrusters import thrusters_of
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.sitl.backend import SimThrusterOutput
from autopilot.sitl.mismatch import mismatched
from autopilot.sitl.plant import Plant
from autopilot.sitl.simulated_waters import SimulatedWaters
from autopilot.sitl.thruster_models import Thrusters, held

LBV150, BLUEROV2 = load_vehicle("lbv150"), load_vehicle("bluerov2")
T200 = BLUEROV2.drive


@given(st.integers(1090, 1910), st.floats(9.0, 22.0))
def test_allocation_and_plant_read_a_curve_alike(pulse: int, supply_v: float) -> None:
    believed = Allocation(BLUEROV2.thrusters).thrust_n(0, pulse, supply_v)
    assert believed == pytest.approx(held(T200, pulse).at(supply_v), abs=1e-9)


@given(st.floats(-40.0, 40.0), st.floats(12.0, 18.0))
def test_the_inverse_of_a_curve_is_the_nearest_pulse(thrust_n: float, supply_v: float) -> None:
    allocation = Allocation(BLUEROV2.thrusters)
    pulse = allocation.pulse_us(0, thrust_n, supply_v)
    offset = pulse - T200.neutral_us
    given_n = allocation.thrust_n(0, pulse, supply_v)
    assert abs(offset) <= T200.span_us and abs(given_n) <= T200.limit_n and given_n * thrust_n >= 0.0
    wanted = float(np.clip(thrust_n, -T200.limit_n, T200.limit_n))
    every = [allocation.thrust_n(0, 1500 + o, supply_v) for o in range(-400, 401)]
    usable = [abs(force - wanted) for force in every if abs(force) <= T200.limit_n]
    if offset and abs(offset) < T200.span_us:
        assert abs(given_n - wanted) == pytest.approx(min(usable), abs=1e-9)
    elif not offset:
        assert abs(wanted) < 0.5


def test_published_figures_of_the_t200() -> None:
    assert held(T200, 1900).at(16.0) == pytest.approx(51.4)
    assert held(T200, 1100).at(16.0) == pytest.approx(-39.9)
    assert held(T200, 1528).at(16.0) == held(T200, 1472).at(16.0) == 0.0
    assert held(T200, 1532).at(16.0) == pytest.approx(0.4, abs=0.1)
    assert held(T200, 1900).at(15.0) == pytest.approx(0.5 * (44.4 + 51.4))
    full = Thrusters(thrusters_of(BLUEROV2.thruster_tables[:2], T200))
    full.step((1900, 1100), 16.0, 10.0)
    assert full.power_w == pytest.approx(0.997 * 51.4**1.5 + 1.45 * 39.9**1.5)


def shuffled(vehicle: Vehicle, channels: tuple[int, ...], reversed_ones: tuple[int, ...]) -> Vehicle:
    tables = tuple(
        msgspec.structs.replace(table, channel=channel, reversed=index in reversed_ones)
        for index, (table, channel) in enumerate(zip(vehicle.thruster_tables, channels, strict=True))
    )
    return msgspec.structs.replace(vehicle, thruster_tables=tables)


def test_channels_and_turning_directions_change_nothing_but_the_wires() -> None:
    """From thrust over pulses and outputs to the motion of the hull."""
    wanted = [3.0, -4.0, 2.0, 5.0]
    truths = []
    for vehicle in (LBV150, shuffled(LBV150, (7, 2, 16, 3), (0, 3))):
        output = SimThrusterOutput(vehicle)
        output.open()
        output.write(0, Allocation(vehicle.thrusters).pulses_us(wanted, 19.0))
        plant = Plant(vehicle, SimulatedWaters(), start_pos_ned_m=(0.0, 0.0, 20.0))
        plant.advance(2_000_000, output.pwm_us)
        truths.append(plant.truth)
    assert len(output.pwm_us) == 16 and output.pwm_us.count(0) == 12
    assert np.array_equal(truths[0].thrust_n, truths[1].thrust_n) and truths[0].thrust_n[0] > 2.9
    assert np.array_equal(truths[0].pos_ned_m, truths[1].pos_ned_m)


def test_a_thruster_may_have_a_drive_of_its_own() -> None:
    tables = list(LBV150.thruster_tables)
    tables[2] = msgspec.structs.replace(tables[2], drive=T200, limit_n=20.0)
    vehicle = msgspec.structs.replace(LBV150, thruster_tables=tuple(tables))
    allocation = Allocation(vehicle.thrusters)
    assert allocation.capability_n(16.0).tolist() == pytest.approx(
        [0.03457 * 256.0, 0.03457 * 256.0, 20.0, 0.03457 * 256.0]
    )
    pulses = allocation.pulses_us([0.0, 0.0, 15.0, 6.0], 16.0)
    plant = Plant(
        vehicle,
        SimulatedWaters(),
        start_pos_ned_m=(0.0, 0.0, 20.0),
        mismatch={"supply": 16.0 / 19.0, "resistance": 0.0},
    )
    plant.advance(3_000_000, pulses)
    assert plant.truth.thrust_n[2:4] == pytest.approx([15.0, 6.0], abs=0.15)


@pytest.mark.parametrize("key", ["thrust", "lag", "deadband", "power"])
def test_mismatch_reaches_curves_and_drives_of_their_own(key: str) -> None:
    tables = list(BLUEROV2.thruster_tables)
    tables[0] = msgspec.structs.replace(tables[0], drive=LBV150.drive)
    vehicle = mismatched(msgspec.structs.replace(BLUEROV2, thruster_tables=tuple(tables)), {key: 0.5})
    brushed, curve = vehicle.thrusters[0].drive, vehicle.thrusters[1].drive
    if key == "thrust":
        assert brushed.brushed_law[1] == 0.5 * LBV150.drive.brushed_law[1]
        assert held(curve, 1900).at(16.0) == pytest.approx(0.5 * 51.4)
    elif key == "lag":
        assert (brushed.time_constant_s, curve.time_constant_s) == (0.075, 0.075)
    elif key == "deadband":
        assert held(curve, 1514).at(16.0) == 0.0 < held(curve, 1518).at(16.0)
        assert held(curve, 1900).at(16.0) == pytest.approx(51.4)
    else:
        assert (brushed.power_w_n15, curve.reverse_power_w_n15) == (0.6, 0.725)
    none = mismatched(BLUEROV2, {"deadband": 0.0}).drive
    assert held(none, 1502).at(16.0) > 0.0 == held(none, 1500).at(16.0)
