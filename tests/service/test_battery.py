"""What the battery says, through the real service: what cannot be is refused, what is low acts without being asked."""

import math
from dataclasses import replace

import numpy as np
import pytest
from piloted_world import HOLD, MANUAL, PilotedWorld
from pymavlink.dialects.v20 import development as mav

from autopilot.core.messages import Failsafe, Outputs
from autopilot.core.samples import PowerSample, Sample
from autopilot.core.vehicle import load_vehicle

LIMITS = load_vehicle("lbv150").battery.limits
SENSOR, LOW, CRITICAL = (1 << bit for bit in (Failsafe.SENSOR, Failsafe.BATTERY, Failsafe.BATTERY_CRITICAL))
RNG = np.random.default_rng(25)
IMPLAUSIBLE = (
    *(math.nan, 65.535),
    round(float(RNG.uniform(0.5 * LIMITS.min_v, LIMITS.min_v - 0.01)), 2),
    round(float(RNG.uniform(LIMITS.max_v + 0.01, 100.0)), 2),
)


class BatteryWorld(PilotedWorld):
    """A pilot's vehicle whose battery says what a test wants."""

    def __init__(self, volts: float, **params: float) -> None:
        super().__init__(params=params)
        self.volts = volts
        self.said: list[str] = []
        self.counted: dict[str, int] = {}

    def samples(self) -> tuple[Sample, ...]:
        return tuple(replace(s, voltage_v=self.volts) if isinstance(s, PowerSample) else s for s in super().samples())

    def tick(self, *given: object) -> Outputs:
        outputs = super().tick(*given)  # type: ignore[arg-type]
        self.said += [event.text for event in outputs.events]
        if outputs.counters is not None:
            self.counted = dict(outputs.counters.counts)
        return outputs

    def flown(self, volts: float) -> list[tuple[int, ...]]:
        """Pulses under full stick, 2 s at this voltage."""
        self.volts = volts
        return [tuple(self.tick([self.stick()] if n % 4 == 0 else ()).command.pwm_us[:4]) for n in range(200)]

    def stick(self) -> bytes:
        return self.pack(mav.MAVLink_manual_control_message(1, 800, 200, 500, 0, 0))


def afloat(volts: float = 19.0, **params: float) -> BatteryWorld:
    world = BatteryWorld(volts, **params)
    world.run(1.5)
    world.arm()
    return world


def test_a_voltage_that_cannot_be_is_refused_counted_and_told_and_scales_no_thrust() -> None:
    sound, mad = afloat(), afloat()
    assert sound.mode(MANUAL) == mad.mode(MANUAL) == 0
    thrust = set()
    for volts in (19.0, *IMPLAUSIBLE):
        before, pulses = mad.counted.get("power.malformed", 0), mad.flown(volts)
        assert pulses == sound.flown(19.0), volts
        assert (mad.counted.get("power.malformed", 0) > before) is (volts != 19.0), volts
        thrust |= set(pulses)
    assert len(thrust) > 1
    outputs = mad.run(1.0)
    assert outputs.mode.failsafes & SENSOR and not outputs.mode.failsafes & (LOW | CRITICAL)
    assert "Failsafe: power monitor implausible" in mad.said
    assert sum(text.startswith("Battery ") for text in mad.said) == 1
    assert not any(text.startswith("Battery ") for text in sound.said) and "power.malformed" not in sound.counted
    mad.inbox.clear()
    mad.run(1.1)
    status = [m for m in mad.inbox if m.get_type() == "SYS_STATUS"]
    assert {m.voltage_battery for m in status} == {65535}
    mad.volts = 19.0
    outputs = mad.run(1.5)
    assert not outputs.mode.failsafes & SENSOR


@pytest.mark.parametrize("volts", [0.3, math.nan])
def test_a_battery_that_was_never_believed_is_no_sound_one(volts: float) -> None:
    world = BatteryWorld(volts)
    world.run(5.0)
    assert world.command(400, 1.0) != 0
    assert "power monitor implausible: check its cable" in world.texts()
    world.volts = 19.0
    world.run(1.1)
    world.arm()


@pytest.mark.parametrize(("under", "bit"), [("low_v", LOW), ("critical_v", CRITICAL)])
def test_low_voltage_acts_without_having_been_asked_for(under: str, bit: int) -> None:
    volts = getattr(LIMITS, under)
    above, below = afloat(volts + 0.05), afloat(volts - 0.05, FS_BATT_ACT=0.0 if bit == CRITICAL else 2.0)
    outputs = above.run(14.0)
    assert not outputs.mode.failsafes & bit
    outputs = below.run(9.0)
    assert not outputs.mode.failsafes & bit
    outputs = below.run(4.0)
    assert outputs.mode.failsafes & bit
    assert outputs.goal is not None and outputs.goal.pos_ned_m[2] < 0.3  # it surfaces
    text = f"Failsafe: battery at {volts - 0.05:.1f} V" if bit == LOW else "Failsafe: battery critical: surface"
    assert text in below.said


def test_a_voltage_that_the_operator_names_takes_the_place_of_the_vehicle_files() -> None:
    outputs = afloat(17.9, BATT_LOW_VOLT=18.0, BATT_LOW_TIMER=1.0).run(3.0)
    assert outputs.mode.failsafes & LOW
    outputs = afloat(LIMITS.low_v - 0.2, BATT_LOW_VOLT=LIMITS.low_v - 0.4, BATT_LOW_TIMER=1.0).run(3.0)
    assert not outputs.mode.failsafes & LOW


def test_a_low_battery_that_breaks_down_stays_low() -> None:
    world = afloat(LIMITS.low_v - 0.3)
    world.run(5.0)
    world.volts = 3.0
    outputs = world.run(8.0)
    assert outputs.mode.failsafes & LOW and outputs.mode.failsafes & SENSOR


def test_a_low_voltage_forbids_arming_and_says_how_low() -> None:
    world = BatteryWorld(LIMITS.low_v - 0.4)
    world.run(13.0)
    assert world.command(400, 1.0) != 0
    assert f"battery at {LIMITS.low_v - 0.4:.1f} V: charge it" in world.texts()


def test_one_reading_in_ten_that_cannot_be_is_told_once_and_hurts_nothing() -> None:
    world = afloat()
    for second in range(20):
        world.volts = 66.0 if second % 10 == 5 else 19.0
        outputs = world.run(1.0)
        assert not outputs.mode.failsafes & SENSOR
    assert sum(text.startswith("Battery voltage 66.0 V") for text in world.said) == 1
    assert world.counted["power.malformed"] == 2
    assert world.mode(HOLD) == 0


def test_the_texts_of_a_reading_fit_an_operators_line() -> None:
    world = BatteryWorld(66.0)
    world.run(2.0)
    (text,) = [text for text in world.said if text.startswith("Battery")]
    assert text == "Battery voltage 66.0 V, plausible 8 to 22 V: check monitor, vehicle file"
    assert len(text) <= 90
