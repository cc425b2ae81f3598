"""A device's clock behind links as they are: false jumps never, true ones at once."""

import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.core_tuning import CLOCK
from autopilot.core.device_clock import DeviceClock
from tests.lossy_link import LinkConditions, LossyLink

SPAN_US = (1 << 32) * 1000
"""Of a counter of 32 bits in milliseconds."""
WITHHELD_US = 500_000
"""What a change of the latency or of the clock may cost."""
STALL_US = 300_000


@dataclass(frozen=True, kw_only=True)
class Device:
    """A device and what lies between it and us."""

    period_us: int
    jitter_us: int
    """Of its own measuring."""
    resolution_us: int
    drift: float
    begin_us: int
    tick_us: int
    """So often we look."""
    conditions: LinkConditions
    latencies_s: tuple[tuple[float, float], ...]
    """(for so long, this latency) [s]."""
    stalls_s: tuple[float, ...]
    """When the processor stands."""
    seed: int


FRACTIONS = st.sampled_from([0.0, 0.02, 0.05])
CONDITIONS = st.builds(
    LinkConditions,
    latency_s=st.floats(0.005, 0.3),
    jitter_s=st.sampled_from([0.0, 0.003, 0.02]),
    loss=st.floats(0.0, 0.2),
    burst=st.sampled_from([1.0, 3.0]),
    duplicate=FRACTIONS,
    reorder=FRACTIONS,
    ordered=st.booleans(),
)
DEVICES = st.builds(
    Device,
    period_us=st.sampled_from([10_000, 20_000, 100_000]),
    jitter_us=st.sampled_from([0, 500, 2_500]),
    resolution_us=st.sampled_from([1, 1000]),
    drift=st.floats(-3e-4, 3e-4),
    begin_us=st.sampled_from([1_000_000, SPAN_US - 4_000_000]),
    tick_us=st.sampled_from([1_000, 10_000]),
    conditions=CONDITIONS,
    latencies_s=st.lists(st.tuples(st.floats(0.4, 4.0), st.floats(0.005, 0.3)), max_size=8).map(tuple),
    stalls_s=st.lists(st.floats(0.5, 14.0), max_size=3).map(tuple),
    seed=st.integers(0, 1 << 30),
)


@dataclass
class Flight:
    clock: DeviceClock
    arrivals: list[tuple[int, int, int | None]]
    """Arrival, when it was measured, stamp [us]."""

    def given(self) -> list[tuple[int, int, int]]:
        return [(arrival, taken, stamp) for arrival, taken, stamp in self.arrivals if stamp is not None]

    def withheld_us(self) -> int:
        """Longest time in which samples arrived and none was stamped."""
        longest = since = None
        for arrival, _, stamp in self.arrivals:
            since = None if stamp is not None else arrival if since is None else since
            longest = max(longest or 0, arrival - since) if since is not None else longest
        return longest or 0


def fly(device: Device, duration_s: float, ahead: Callable[[int], int] = lambda _: 0) -> Flight:
    """``ahead``: by how much the clock has jumped, by the time [us]."""
    link, clock = LossyLink(device.conditions, device.seed), DeviceClock(SPAN_US)
    flight, changes = Flight(clock, []), list(device.latencies_s)
    stalls, until_us = sorted(round(1e6 * at_s) for at_s in device.stalls_s), 0
    jitter = random.Random(device.seed)
    for next_us in range(0, round(1e6 * duration_s), device.period_us):
        if changes and next_us >= until_us:
            for_s, latency_s = changes.pop()
            until_us = next_us + round(1e6 * for_s)
            link.conditions = replace(link.conditions, latency_s=latency_s)
        if stalls and next_us >= stalls[0]:
            link.stall(stalls.pop(0) + STALL_US)
        taken_us = next_us - (jitter.randint(0, device.jitter_us) if device.jitter_us else 0)
        shown_us = device.begin_us + round(taken_us * (1.0 + device.drift)) + ahead(taken_us)
        shown_us = shown_us // device.resolution_us * device.resolution_us % SPAN_US
        link.put(next_us, b"%d %d" % (taken_us, shown_us))
        while (due_us := link.next_us) is not None and due_us <= next_us:
            t_us = -(-due_us // device.tick_us) * device.tick_us
            for data in link.take(t_us):
                taken_us, shown_us = map(int, data.split())
                flight.arrivals.append((t_us, taken_us, clock.stamp(t_us, shown_us)))
    return flight


@given(DEVICES)
@settings(max_examples=80, deadline=None)
def test_a_sound_clock_on_a_bad_link_never_jumps(device: Device) -> None:
    flight = fly(device, 15.0)
    assert flight.clock.jumps == 0 and flight.clock.take_notices() == []
    stamps = flight.given()
    assert all(before[2] < after[2] for before, after in pairwise(stamps))
    assert all(stamp - taken >= -20_000 and stamp - arrival <= CLOCK.early_us for arrival, taken, stamp in stamps)
    if device.period_us <= 20_000:  # of others, seconds may lie between two samples that are not lost
        assert flight.withheld_us() <= WITHHELD_US + STALL_US


@given(DEVICES, st.floats(10.0, 11.0))
@settings(max_examples=30, deadline=None)
def test_a_reboot_is_found_on_any_link(device: Device, at_s: float) -> None:
    device = replace(device, period_us=min(device.period_us, 20_000))
    flight = fly(device, 15.0, lambda t_us: -500_000_000 if t_us >= 1e6 * at_s else 0)
    assert flight.clock.jumps == 1
    after = [arrival for arrival, taken, _ in flight.given() if taken >= 1e6 * at_s]
    assert after[0] - 1e6 * at_s <= WITHHELD_US + CLOCK.most_latency_us + STALL_US
    assert all(-20_000 <= stamp - taken <= 1e6 for _, taken, stamp in flight.given())


@pytest.mark.parametrize("step_s", [0.5, -0.5])
@given(device=DEVICES, at_s=st.floats(6.0, 7.0))
@settings(max_examples=30, deadline=None)
def test_a_step_of_half_a_second_is_found_where_a_tenth_is_lost(device: Device, at_s: float, step_s: float) -> None:
    """The latency was the same for long; where it falls by as much as the clock steps, both look alike."""
    now = device.conditions
    quiet = replace(now, loss=0.5 * now.loss, burst=1.0, jitter_s=min(now.jitter_s, 0.003))
    device = replace(device, period_us=min(device.period_us, 20_000), conditions=quiet, latencies_s=(), stalls_s=())
    flight = fly(device, 10.0, lambda t_us: round(1e6 * step_s) if t_us >= 1e6 * at_s else 0)
    assert len(flight.arrivals) > CLOCK.settled
    assert flight.clock.jumps == 1
    ((_, text),) = flight.clock.take_notices()
    assert f"clock jumped {step_s:+.1f}"[:16] in text or float(text.split()[2]) == pytest.approx(step_s, abs=0.06)
    after = [arrival for arrival, taken, _ in flight.given() if taken >= 1e6 * at_s]
    assert after[0] - 1e6 * at_s <= WITHHELD_US + CLOCK.most_latency_us
