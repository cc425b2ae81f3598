"""Pictures without stamps: the camera's beat is found under delays of every kind, and not where there is none."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.drivers import frame_clock
from autopilot.drivers.drivers_tuning import FRAMES
from autopilot.drivers.frame_clock import FrameClock, LoopTime, StreamClock

Delay = Callable[[np.random.Generator], float]
"""Of one picture [us]."""
DELAYS: dict[str, Delay] = {
    "none": lambda rng: 4000.0,
    "even": lambda rng: rng.uniform(2000.0, 8000.0),
    "ticks": lambda rng: 10_000.0 * rng.integers(0, 2),
    "tail": lambda rng: 5000.0 + rng.exponential(4000.0),
    "normal": lambda rng: 60_000.0 + 3000.0 * rng.standard_normal(),
    "stalls": lambda rng: 5000.0 + rng.uniform(0.0, 2000.0) + 20_000.0 * (rng.random() < 0.05),
}


def stream(clock: FrameClock, rate_hz: float, delay: Delay, rng: np.random.Generator, count: int, lost: float = 0.0):
    """(n, 2) how late arrivals and stamps are [us]."""
    found, before = [], -1
    for k in range(count):
        if rng.random() < lost:
            continue
        taken_us = k * 1e6 / rate_hz
        before = max(before + 1, round(taken_us + delay(rng)))
        found.append((before - taken_us, clock.stamp(before) - taken_us))
    return np.array(found)


@settings(max_examples=60)
@given(
    st.floats(9.0, 45.0),
    st.sampled_from(sorted(DELAYS)),
    st.sampled_from([0.0, 0.1, 0.4]),
    st.integers(0, 1 << 30),
)
def test_stamps_vary_less_than_arrivals(rate_hz: float, kind: str, lost: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    if kind in ("ticks", "tail", "stalls") and rate_hz > 30.0:
        rate_hz /= 2.0  # half a picture's time of jitter is no beat
    clock = FrameClock()
    late_us = stream(clock, rate_hz, DELAYS[kind], rng, 3 * FRAMES.window, lost)[3 * FRAMES.first :]
    arrivals, stamps = late_us[:, 0], late_us[:, 1]
    assert clock.rate_hz == pytest.approx(rate_hz, rel=0.003)
    assert stamps.mean() == pytest.approx(arrivals.mean(), abs=2500.0)  # latency_s is a mean delay
    inner = np.ptp(np.percentile(stamps, [2, 98]))
    assert inner <= max(0.5 * np.ptp(np.percentile(arrivals, [2, 98])), 400.0)


HEAVY: dict[str, Delay] = {
    **DELAYS,
    "a third of a beat": lambda rng: 80_000.0 + 10_000.0 * rng.standard_normal(),
    "a beat": lambda rng: 100_000.0 + 30_000.0 * rng.standard_normal(),
}


@settings(max_examples=60)
@given(st.floats(9.0, 30.0), st.sampled_from(sorted(HEAVY)), st.sampled_from([0.0, 0.1]), st.integers(0, 1 << 30))
def test_stamps_say_how_far_they_are_off(rate_hz: float, kind: str, lost: float, seed: int) -> None:
    clock = FrameClock()
    late_us = stream(clock, rate_hz, HEAVY[kind], np.random.default_rng(seed), 2 * FRAMES.window, lost)[:, 1]
    last = late_us[-FRAMES.first :]
    scatter_us = 1.4826 * np.median(np.abs(last - np.median(last)))
    assert scatter_us < 1.5 * clock.sigma_us + 500.0
    assert clock.sigma_us < 3.0 * np.ptp(late_us) + 500.0


@given(st.integers(0, 1 << 30))
@settings(max_examples=30)
def test_without_a_beat_arrivals_stand_for_themselves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clock, t_us, moved = FrameClock(), 0.0, []
    for _ in range(600):
        t_us += rng.uniform(15_000.0, 80_000.0)
        moved.append(abs(clock.stamp(round(t_us)) - round(t_us)))
    assert np.mean(np.array(moved) > 0) < 0.1


def test_a_beat_is_not_looked_for_with_every_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    searches, find = [], frame_clock._find
    monkeypatch.setattr(frame_clock, "_find", lambda times: searches.append(1) or find(times))
    rng, clock = np.random.default_rng(5), FrameClock()
    for t_us in np.cumsum(rng.uniform(15_000.0, 80_000.0, 900)):
        clock.stamp(round(t_us))
    assert 20 < len(searches) <= 900 // FRAMES.again


def test_a_stream_that_changes_its_rate_is_found_again() -> None:
    rng = np.random.default_rng(3)
    clock = FrameClock()
    stream(clock, 30.0, DELAYS["tail"], rng, 300)
    start_us = 11_000_000
    late = []
    for k in range(400):
        taken_us = start_us + k * 80_000.0
        late.append(clock.stamp(round(taken_us + DELAYS["tail"](rng))) - taken_us)
    assert clock.rate_hz == pytest.approx(12.5, rel=0.003)
    assert np.std(late[200:]) < 1500.0


def test_a_delay_that_grows_for_good_is_followed() -> None:
    rng = np.random.default_rng(4)
    clock = FrameClock()
    stream(clock, 25.0, DELAYS["tail"], rng, 500)
    late = []
    for k in range(500, 800):
        taken_us = k * 40_000.0
        late.append(clock.stamp(round(taken_us + 15_000.0 + DELAYS["tail"](rng))) - taken_us)
    assert np.mean(late[-50:]) == pytest.approx(24_000.0, abs=2500.0)


@pytest.mark.parametrize("times", [[0, 0, 0], [5, 4, 3], [0] * 300, list(range(300)), [1 << 60, 0, 1 << 60]])
def test_any_arrivals_are_stamped(times: list[int]) -> None:
    clock = FrameClock()
    for time_us in times:
        assert abs(clock.stamp(time_us) - time_us) < 1_000_000


def test_late_ticks_do_not_move_the_time_of_a_picture() -> None:
    """The loop says when a tick was due; pictures are stamped by when they came."""
    told = LoopTime()
    rng = np.random.default_rng(5)
    for tick in range(300):
        told.observe(10_000 * tick, 7_000_000 + 10_000 * tick + round(rng.exponential(6000.0)))
    assert told.at(7_000_000 + 3_000_000) == pytest.approx(3_000_000, abs=300)


def streamed(clock: StreamClock, times_us: np.ndarray, late_us: np.ndarray, begin_us: float = 0.0) -> np.ndarray:
    """(n,) how late the stamps are [us]; NaN where there is none. Arrivals in order, the stream's clock its own."""
    arrivals = np.maximum.accumulate(times_us + late_us)
    stamps = [clock.stamp(round(at), at_stream - begin_us) for at, at_stream in zip(arrivals, times_us, strict=True)]
    return np.array([np.nan if stamp is None else stamp for stamp in stamps]) - times_us


@settings(max_examples=40)
@given(
    st.floats(8.0, 60.0),
    st.floats(500.0, 12_000.0),
    st.floats(0.0, 100_000.0),
    st.sampled_from([0.0, 0.3]),
    st.integers(0, 1 << 30),
)
def test_a_streams_own_stamps_hold_through_jitter_load_and_loss(
    rate_hz: float, jitter_us: float, load_us: float, lost: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    times_us = np.arange(900) * 1e6 / rate_hz + 1e6
    times_us = times_us[rng.random(len(times_us)) >= lost]
    late_us = 60_000.0 + rng.exponential(jitter_us, len(times_us))
    busy = (np.arange(len(times_us)) > 300) & (np.arange(len(times_us)) < 400)
    off_us = streamed(StreamClock(), times_us, late_us + load_us * busy, begin_us=float(rng.uniform(0.0, 1e9)))
    assert np.isnan(off_us[: FRAMES.first - 1]).all() and not np.isnan(off_us[FRAMES.first :]).any()
    assert abs(off_us[FRAMES.first] - late_us[: FRAMES.first].mean()) < 0.5 * jitter_us + 500.0, "latency_s is a mean"
    assert np.ptp(off_us[FRAMES.first :]) < jitter_us + 500.0


def test_a_stream_that_begins_anew_has_another_clock() -> None:
    clock, times_us = StreamClock(), np.arange(200) * 33_333.0
    streamed(clock, times_us, np.full(200, 50_000.0))
    again = streamed(clock, times_us + 1e8, np.full(200, 50_000.0), begin_us=1e8)
    assert np.isnan(again[: FRAMES.first - 1]).all() and again[-1] == pytest.approx(50_000.0, abs=2.0)
    set_ahead = streamed(clock, times_us + 2e8, np.full(200, 50_000.0), begin_us=-1e6)
    assert set_ahead[-1] == pytest.approx(50_000.0, abs=2.0), f"after {FRAMES.lost_count} arrivals at most"
