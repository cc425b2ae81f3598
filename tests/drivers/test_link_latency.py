"""The latency of a flight controller's link: found by round trips, and 0 where it is not known."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.drivers.ardusub_telemetry import ANSWER_US, DIRECT_US, LinkLatency
from tests.lossy_link import LinkConditions, LossyLink

SPAN_US = (1 << 32) * 1000
SECOND = 1_000_000


def heard(latency: LinkLatency, up: LossyLink, down: LossyLink, *, behind_us: int, until_us: int, since_us: int = 0):
    """Ask and answer on ticks of 10 ms; the device's clock is ``behind_us`` behind ours."""
    for t_us in range(since_us, until_us, 10_000):
        if latency.due(t_us):
            up.put(t_us, str(1000 * t_us).encode())
        for data in up.take(t_us):
            down.put(t_us, b"%d %s" % (1000 * (t_us - behind_us), data))
        for data in down.take(t_us):
            tc1_ns, ts1_ns = map(int, data.split())
            latency.take(t_us, tc1_ns, ts1_ns)


@given(
    st.floats(0.02, 0.3),
    st.floats(0.0, 0.2),
    st.sampled_from([0.0, 0.01]),
    st.sampled_from([-5 * SECOND, SPAN_US - 2 * SECOND]),
    st.integers(0, 1 << 20),
)
@settings(max_examples=30, deadline=None)
def test_a_constant_latency_is_found_whatever_is_lost(
    latency_s: float, loss: float, jitter_s: float, begin_us: int, seed: int
) -> None:
    """``begin_us``: what the device's counter shows when ours begins; its measurements wrap, TIMESYNC does not."""
    conditions = LinkConditions(latency_s=latency_s, loss=loss, jitter_s=jitter_s)
    latency = LinkLatency(SPAN_US)
    heard(
        latency,
        LossyLink(conditions, seed),
        LossyLink(conditions, seed + 1),
        behind_us=-abs(begin_us),
        until_us=5 * SECOND,
    )
    arrivals_ahead_us = -abs(begin_us) + 1e6 * latency_s
    for ahead_us in (arrivals_ahead_us, arrivals_ahead_us + SPAN_US):
        assert latency.beyond_us(ahead_us) == pytest.approx(max(0.0, 1e6 * latency_s - DIRECT_US), abs=30_000)


def test_a_cable_has_none() -> None:
    latency, cable = LinkLatency(SPAN_US), LinkConditions(latency_s=0.004)
    heard(latency, LossyLink(cable, 0), LossyLink(cable, 1), behind_us=-SECOND, until_us=5 * SECOND)
    assert latency.beyond_us(-SECOND + 8_000.0) == 0.0


def test_after_a_restart_it_is_found_again() -> None:
    latency, tether = LinkLatency(SPAN_US), LinkConditions(latency_s=0.1)
    up, down = LossyLink(tether, 0), LossyLink(tether, 1)
    heard(latency, up, down, behind_us=-500 * SECOND, until_us=5 * SECOND)
    assert latency.beyond_us(5 * SECOND + 100_000.0) == 0.0, "the clock of before"
    heard(latency, up, down, behind_us=5 * SECOND, since_us=5 * SECOND, until_us=7 * SECOND)
    assert latency.beyond_us(5 * SECOND + 100_000.0) == pytest.approx(100_000.0 - DIRECT_US, abs=10_000)


def test_what_is_no_answer_to_us_counts_for_nothing() -> None:
    latency = LinkLatency(SPAN_US)
    assert latency.due(0) and not latency.due(50_000) and latency.due(100_000)
    latency.take(200_000, 0, 100_000_000)  # a request
    latency.take(200_000, 5, 70_000_000)  # an answer to another
    latency.take(ANSWER_US + 200_000, 5, 100_000_000)  # too late
    latency.take(200_000, -5, 100_000_000)
    assert latency.beyond_us(1e6) == 0.0
