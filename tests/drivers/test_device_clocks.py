"""Every driver whose device has a clock of its own: what a jump of that clock costs, and that stamps are right."""

import itertools
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulators import A50Server, EllipseEmulator
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav
from sensor_rigs import VEHICLE, Ig500Rig, truth

import autopilot.drivers
from autopilot.core.core_tuning import CLOCK
from autopilot.core.device_clock import DeviceClock
from autopilot.core.messages import Severity
from autopilot.drivers.ardusub_telemetry import ArduSubTelemetry
from autopilot.drivers.base import AlwaysOpen
from autopilot.drivers.ellipse import Ellipse, EllipseOptions
from autopilot.drivers.ig500 import Ig500
from autopilot.drivers.waterlinked_a50 import WaterLinkedA50, WaterLinkedA50Options
from autopilot.sitl.ahrs import Ig500Emulator
from autopilot.sitl.sensor_tables import AhrsSensor

COST_US = 500_000
"""What a jump may cost."""
FIRST_US = 450_000
"""Until so long after a jump of less than CLOCK.far_us stamps may be off by it."""
SKIPPED_STEPS = 5
"""A clock that goes forward by fewer steps may be one of which samples are lost."""
UNIX_US = 1 << 60
"""Does not wrap."""
NEAR_US = 6_000
"""Arrivals jitter by 2 ms, clocks count milliseconds, the mean of the jitter stays in the stamps."""


class Line(AlwaysOpen):
    """A byte port with what the device has said."""

    def __init__(self, emulator: Any = None) -> None:
        self.emulator = emulator
        self.said: list[bytes] = []

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        answers = [] if self.emulator is None else self.emulator.read(t_us)
        said, self.said = self.said, []
        return [*answers, *((t_us, data) for data in said)]

    def write(self, data: bytes) -> None:
        if self.emulator is not None:
            self.emulator.write(data)


class Ig500Source:
    """SBG IG-500A: milliseconds."""

    period_us, span_us, stamped_by_clock = 10_000, (1 << 32) * 1000, True

    def __init__(self) -> None:
        exact = {name: 0.0 for name in AhrsSensor.__struct_fields__ if "noise" in name or "bias" in name}
        self._device = Ig500Emulator(AhrsSensor(latency_jitter_s=0.0, latency_s=0.0, **exact), VEHICLE.ahrs, [], 0)
        self._driver = Ig500(self._device, latency_s=0.0)
        self._driver.open()
        self.clock: DeviceClock = self._driver.clock

    def say(self, arrival_us: int, taken_us: int, device_us: int) -> list[Any]:
        self._device.clock_ahead_us = device_us - taken_us
        self._device.observe(truth(taken_us))
        return self._driver.poll(arrival_us)


class EllipseSource:
    """SBG Ellipse: microseconds."""

    period_us, span_us, stamped_by_clock = 10_000, 1 << 32, True

    def __init__(self) -> None:
        self._line = Line()
        self._driver = Ellipse(VEHICLE, EllipseOptions(port=""), port=self._line)
        self._latency_us = round(1e6 * VEHICLE.ahrs.latency_s)
        self._driver.open()
        self.clock = self._driver.clock

    def say(self, arrival_us: int, taken_us: int, device_us: int) -> list[Any]:
        ahead_us = device_us - 4_000_000_000
        self._line.said = [data for _, data in EllipseEmulator.logs(ahead_us)]
        return moved(self._driver.poll(arrival_us), self._latency_us)


class TelemetrySource:
    """ArduSub: milliseconds since its boot."""

    period_us, span_us, stamped_by_clock = 20_000, (1 << 32) * 1000, True

    def __init__(self) -> None:
        self._driver = ArduSubTelemetry(VEHICLE, density_kg_m3=1000.0, depth_sigma_m=0.01, ground_pa=None)
        self._latency_us = round(1e6 * VEHICLE.ahrs.latency_s)
        self.clock = self._driver.clock

    def say(self, arrival_us: int, taken_us: int, device_us: int) -> list[Any]:
        self._driver.take(arrival_us, mav.MAVLink_raw_imu_message(0, 0, 0, -1000, 0, 0, 0, 0, 0, 0))
        shown = mav.MAVLink_attitude_message(device_us // 1000 % (1 << 32), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return moved(self._driver.take(arrival_us, shown), self._latency_us)


class A50Source:
    """Water Linked A50: Unix time; only the age of a report is used."""

    period_us, span_us, stamped_by_clock = 100_000, UNIX_US, False

    def __init__(self) -> None:
        self._driver = WaterLinkedA50(VEHICLE, WaterLinkedA50Options())
        ours, self._theirs = socket.socketpair()
        ours.setblocking(False)
        self._driver._socket = ours
        self.clock = self._driver.clock

    def __del__(self) -> None:
        self._driver.close()
        self._theirs.close()

    def say(self, arrival_us: int, taken_us: int, device_us: int) -> list[Any]:
        self._theirs.sendall(A50Server.report(device_us))
        return moved(self._driver.poll(arrival_us), 120_000)  # what a report says of its age


SOURCES: dict[str, Callable[[], Any]] = {
    "ig500": Ig500Source,
    "ellipse": EllipseSource,
    "ardusub_telemetry": TelemetrySource,
    "waterlinked_a50": A50Source,
}
"""Module of the driver -> source."""


def moved(samples: list[Any], by_us: int) -> list[Any]:
    """Stamps with the latency that was taken off."""
    return [Stamped(sample.t_us + by_us) for sample in samples]


@dataclass
class Stamped:
    """A stamp."""

    t_us: int


@dataclass
class Run:
    """What came out of a source."""

    source: Any
    stamps: list[tuple[int, int, int]] = field(default_factory=list)
    """Stamp, when it was taken, when it arrived [us]."""

    def silences_us(self) -> list[int]:
        arrivals = [arrival_us for _, _, arrival_us in self.stamps]
        return [after - before for before, after in itertools.pairwise(arrivals)]


def fly(
    name: str,
    jumps: list[tuple[float, float]],
    duration_s: float,
    *,
    begin_us: int = 1_000_000_000,
    drift: float = 0.0,
    late: Callable[[int], int] = lambda _: 0,
    lost: Callable[[int], bool] = lambda _: False,
) -> Run:
    """Samples of a device whose clock jumps: (when, by how much) [s]. ``late``: us by which the n-th is delivered
    late; ``lost``: whether it is lost."""
    source, rng = SOURCES[name](), np.random.default_rng(3)
    run, arrived_us = Run(source), 0
    for n in range(round(duration_s * 1e6 / source.period_us)):
        taken_us = 500_000 + n * source.period_us
        ahead_s = sum(size_s for at_s, size_s in jumps if taken_us >= (at_s * 1e6))
        device_us = begin_us + round(taken_us * (1.0 + drift) + 1e6 * ahead_s)
        jitter_us = int(rng.integers(0, 2_000))
        arrived_us = max(arrived_us, taken_us + jitter_us + late(n))
        if lost(n):
            continue
        for sample in source.say(arrived_us, taken_us, device_us % source.span_us):
            run.stamps.append((sample.t_us, taken_us, arrived_us))
    return run


def right(run: Run, jumps: list[tuple[float, float]]) -> None:
    """Stamps rise and are right; each jump has cost no more than it may."""
    stamps = [stamp for stamp, _, _ in run.stamps]
    assert all(before < after for before, after in itertools.pairwise(stamps))
    for stamp_us, taken_us, _ in run.stamps:
        small = [
            1e6 * abs(size_s)
            for at_s, size_s in jumps
            if at_s * 1e6 <= taken_us <= at_s * 1e6 + FIRST_US and 1e6 * abs(size_s) <= CLOCK.far_us + NEAR_US
        ]
        assert abs(stamp_us - taken_us) <= NEAR_US + sum(small), (stamp_us - taken_us, taken_us)
    assert max(run.silences_us()) <= COST_US + 2 * run.source.period_us


def test_every_driver_with_a_device_clock_stands_in_this_suite() -> None:
    folder = Path(str(autopilot.drivers.__file__)).parent
    using = {path.stem for path in folder.glob("*.py") if "DeviceClock(" in path.read_text()}
    assert using == set(SOURCES)
    stamped = re.compile(r"time_boot_ms|TIME_SINCE_RESET|time_of_validity|device_us\b")
    wire = {"ig500_protocol", "ellipse_protocol", "ardusub"}  # bytes, and a reboot that is only looked for
    assert {path.stem for path in folder.glob("*.py") if stamped.search(path.read_text())} - wire == set(SOURCES)


SIZES_S = st.one_of(
    st.floats(0.012, 0.2), st.floats(0.2, 20.0), st.floats(20.0, 20_000.0), st.sampled_from([0.05, 1.0, 8.0, 3600.0])
)


@pytest.mark.parametrize("name", SOURCES)
@given(size_s=SIZES_S, back=st.booleans(), at_s=st.floats(3.0, 4.0), wraps=st.booleans())
@settings(max_examples=12, deadline=None)
def test_a_jump_costs_half_a_second_at_most_and_is_told(
    name: str, size_s: float, back: bool, at_s: float, wraps: bool
) -> None:
    span_us = SOURCES[name]().span_us
    begin_us = span_us - 5_000_000 if wraps and span_us < UNIX_US else 30_000_000_000
    settled = 1e-6 * CLOCK.settled * SOURCES[name]().period_us
    jumps = [(at_s + settled, -size_s if back else size_s)]
    run = fly(name, jumps, settled + 6.0, begin_us=begin_us)
    right(run, jumps)
    clear_us = (2 if back else SKIPPED_STEPS) * run.source.period_us
    if 1e6 * size_s <= max(clear_us, CLOCK.far_us + NEAR_US):  # lost samples may do the same
        assert run.source.clock.jumps <= 1
        return
    assert run.source.clock.jumps == 1
    ((_, text),) = run.source.clock.take_notices()
    told = re.fullmatch(r"clock jumped (\S+) s: check power, time sync", text)
    assert told, text
    if abs(size_s) < 1000.0:
        assert float(told[1]) == pytest.approx(jumps[0][1], rel=0.02, abs=0.006)


@pytest.mark.parametrize("name", SOURCES)
@given(jumps=st.lists(st.tuples(st.floats(1.0, 10.0), st.floats(-30.0, 30.0)), min_size=2, max_size=20))
@settings(max_examples=6, deadline=None)
def test_repeated_jumps_never_silence_a_device(name: str, jumps: list[tuple[float, float]]) -> None:
    run = fly(name, jumps, 13.0)
    assert max(run.silences_us()) <= COST_US + 2 * run.source.period_us
    calm = [stamped for stamped in run.stamps if not any(0 <= stamped[1] - at * 1e6 <= COST_US for at, _ in jumps)]
    assert all(abs(stamp_us - taken_us) <= NEAR_US + 2_000 for stamp_us, taken_us, _ in calm)


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize("drift", [-3e-4, 3e-4])
def test_a_sound_clock_is_never_blamed(name: str, drift: float) -> None:
    """Drift, a counter that begins anew, frames that are lost and a line that stalls are no jumps."""
    rng = np.random.default_rng(8)
    lost = set(rng.integers(0, 2000, 60).tolist())
    period_us = SOURCES[name]().period_us
    stall = range(700, 700 + max(1, 300_000 // period_us))
    run = fly(
        name,
        [],
        20.0,
        begin_us=min(SOURCES[name]().span_us, UNIX_US // 2) - 10_000_000,
        drift=drift,
        late=lambda n: (stall[-1] - n) * period_us if n in stall else 0,
        lost=lambda n: n in lost,
    )
    assert run.source.clock.jumps == 0
    assert run.source.clock.take_notices() == []
    if run.source.stamped_by_clock:
        assert all(abs(stamp_us - taken_us) <= NEAR_US for stamp_us, taken_us, _ in run.stamps)


@pytest.mark.parametrize("jump_s", [8.0, -8.0, 0.2])
def test_a_vehicle_with_the_device_on_its_line_goes_on_and_its_operator_is_told(tmp_path: Path, jump_s: float) -> None:
    rig = Ig500Rig(tmp_path)
    try:
        rig.emulator.clock_ahead_us = 20_000_000
        rig.run(3.0)
        rig.emulator.clock_ahead_us += round(1e6 * jump_s)
        jumped_us = rig.t_us
        after = rig.run(7.0)
        assert after[0].t_us - jumped_us <= COST_US
        assert all(rig.right(sample) for sample in after)
        assert abs(after[-1].t_us - rig.t_us) <= 25_000  # the vehicle file's latency
        ((severity, text),) = rig.steady.take_notices()
        assert severity is Severity.WARNING
        assert text.startswith("device: clock jumped ") and text.endswith(": check power, time sync")
    finally:
        rig.close()


def test_a_dvl_whose_clock_is_set_between_measuring_and_sending_keeps_its_stamps() -> None:
    driver = A50Source()
    stamps = []
    for n in range(1, 60):
        told = {"time_of_validity": 10**15, "time_of_transmission": 10**15 + 120_000}
        if n in (30, 40):
            told["time_of_transmission"] += 900_000 if n == 30 else -900_000
        driver._theirs.sendall(A50Server.report(0, **told))
        stamps += [sample.t_us - 100_000 * n for sample in driver._driver.poll(100_000 * n)]
    assert stamps == [-120_000] * 59


def test_a_reopened_device_may_show_any_time() -> None:
    source = Ig500Source()
    for n in range(300):
        source.say(10_000 * n, 10_000 * n, 10_000 * n)
    source._driver.open()
    samples = []
    for n in range(300, 400):
        samples += source.say(10_000 * n, 10_000 * n, 10_000 * n + 7_200_000_000)
    assert len(samples) >= 95
    assert source.clock.jumps == 0


@pytest.mark.parametrize("name", SOURCES)
@given(at_s=st.floats(2.0, 4.0), lasts_s=st.floats(0.5, 3.0), goes_on=st.booleans())
@example(at_s=3.0, lasts_s=1.0, goes_on=False)  # one equal stamp too few for a clock that stands still
@settings(max_examples=6, deadline=None)
def test_arrivals_are_the_stamps_while_a_clock_stands_still(
    name: str, at_s: float, lasts_s: float, goes_on: bool
) -> None:
    """Then it shows the time, or goes on where it stood. It silenced a device whose data were good."""
    source = SOURCES[name]()
    first, last = (CLOCK.settled + round(1e6 * s / source.period_us) for s in (at_s, at_s + lasts_s))
    first_us, last_us = first * source.period_us, last * source.period_us
    run = Run(source)
    for taken_us in range(0, last_us + 2_000_000, source.period_us):
        behind_us = max(0, min(taken_us, last_us) - first_us) if taken_us < last_us or goes_on else 0
        for sample in source.say(taken_us + 1_000, taken_us, 10_000_000 + taken_us - behind_us):
            run.stamps.append((sample.t_us, taken_us, taken_us))
    cost_us = max(CLOCK.still_us, CLOCK.still_count * source.period_us)
    assert max(run.silences_us()) <= (cost_us if source.stamped_by_clock else 0) + 2 * source.period_us
    assert all(abs(stamp_us - taken_us) <= NEAR_US for stamp_us, taken_us, _ in run.stamps)
    equal_us = last_us - first_us - (0 if goes_on else source.period_us)
    told = [text for _, text in source.clock.take_notices()]
    assert told == ["clock stopped: check power, time sync"] * (equal_us >= cost_us)
