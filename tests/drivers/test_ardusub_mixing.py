"""Channels for ArduSub's mixer, against the emulator's own mixing and the thrusters' curves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.control.thrust.allocation import Allocation
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.errors import ConfigError
from autopilot.core.thrusters import wrench_matrix
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.drivers.ardusub_mixing import FRAMES, NEUTRAL, Mixer
from autopilot.sitl.ardusub_emulator import CHANNEL_OF, FACTORS

VEHICLES = {"vectored": load_vehicle("bluerov2"), "vectored_6dof": load_vehicle("bluerov2-heavy")}
FRAME_NAMES = st.sampled_from(sorted(VEHICLES))
FORCES = st.tuples(*(st.floats(-20.0, 20.0) for _ in range(3)), st.floats(-3.0, 3.0))
SUPPLY = st.floats(13.0, 17.0)


def _pulses(vehicle: Vehicle, force: tuple[float, ...], supply_v: float) -> tuple[int, ...]:
    """As the service makes them."""
    limit_n = np.full(len(vehicle.thrusters), 12.0)
    thrust_n = ControlAllocator.of(vehicle).thrust_n(np.array(force), limit_n)
    return Allocation(vehicle.thrusters).pulses_us(thrust_n, supply_v)


def _sums(frame: str, channels_us: tuple[int, ...]) -> list[int]:
    """Off neutral per motor, by the table of the frame as it was measured."""
    sums = []
    for text in FACTORS[frame]:
        terms = [(1 if sign == "+" else -1, axis) for sign, axis in zip(text[::2], text[1::2], strict=True)]
        sums.append(sum(sign * (channels_us[CHANNEL_OF[axis]] - 1500) for sign, axis in terms))
    return sums


@given(FRAME_NAMES, FORCES, SUPPLY)
def test_force_and_moment_of_the_channels_are_those_of_the_pulses(
    frame: str, force: tuple[float, ...], supply_v: float
) -> None:
    vehicle = VEHICLES[frame]
    pulses = _pulses(vehicle, force, supply_v)
    mixed = Mixer(vehicle, FRAMES[frame]).mix(pulses, supply_v)
    # Motors 1 to 4 of the shipped vehicles push along their direction with a negative sum, those upright with a
    # positive one: what ArduSub's table and the vehicle file say of the same thrusters.
    sides = [-1] * 4 + [1] * (len(pulses) - 4)
    made = tuple(1500 + side * amount for side, amount in zip(sides, _sums(frame, mixed.channels_us), strict=True))
    wrench = np.array(
        wrench_matrix([t.position_frd_m for t in vehicle.thrusters], [t.direction_frd for t in vehicle.thrusters])
    )
    curves = Allocation(vehicle.thrusters)
    missing = wrench @ (curves.thrusts_n(made, supply_v) - curves.thrusts_n(pulses, supply_v))
    # A microsecond is up to 0.18 N per thruster at 17 V, and a channel moves four of them; the dead band is a step.
    assert np.abs(missing[:3]).max() < 1.0
    assert np.abs(missing[3:]).max() < 0.2


@given(FRAME_NAMES, st.lists(st.integers(1000, 2000), min_size=8, max_size=8), st.booleans())
def test_what_is_expected_at_the_servo_rail_is_what_the_table_says(frame: str, asked: list[int], turned: bool) -> None:
    """Any pulses, those that no frame can make among them: channels stay in their range, and no motor is cut."""
    vehicle = VEHICLES[frame]
    mixer = Mixer(vehicle, FRAMES[frame])
    mixer.take({f"MOT_{motor}_DIRECTION": -1.0 if turned else 1.0 for motor in range(1, 9)})
    mixed = mixer.mix(asked[: len(vehicle.thrusters)], 16.0)
    sums = np.array(_sums(frame, mixed.channels_us))
    assert all(1100 <= channel <= 1900 for channel in mixed.channels_us)
    assert np.abs(sums).max() <= 402
    expected = 1500 + (-1 if turned else 1) * np.clip(sums, -400, 400)
    assert np.abs(np.array(mixed.servos_us) - expected).max() <= 1


def test_neutral_is_neutral() -> None:
    for frame, vehicle in VEHICLES.items():
        mixed = Mixer(vehicle, FRAMES[frame]).mix((1500,) * len(vehicle.thrusters), 16.0)
        assert mixed.channels_us == NEUTRAL
        assert set(mixed.servos_us) == {1500}


def test_another_gain_of_yaw_is_allowed_for() -> None:
    mixer = Mixer(VEHICLES["vectored"], FRAMES["vectored"])
    pulses = _pulses(VEHICLES["vectored"], (0.0, 0.0, 0.0, 2.0), 16.0)
    plain = mixer.mix(pulses, 16.0)
    mixer.take({"ACRO_YAW_P": 2.0 * 3.375})
    doubled = mixer.mix(pulses, 16.0)
    yaw = CHANNEL_OF["Y"]
    assert doubled.channels_us[yaw] - 1500 == pytest.approx(0.5 * (plain.channels_us[yaw] - 1500), abs=1.0)
    assert np.abs(np.array(doubled.servos_us) - plain.servos_us).max() <= 2


def test_a_vehicle_of_another_frame_is_refused() -> None:
    with pytest.raises(ConfigError, match="frame vectored_6dof has motors 1 to 8"):
        Mixer(VEHICLES["vectored"], FRAMES["vectored_6dof"])
    with pytest.raises(ConfigError, match="frame vectored has motors 1 to 6"):
        Mixer(load_vehicle("lbv150"), FRAMES["vectored"])
