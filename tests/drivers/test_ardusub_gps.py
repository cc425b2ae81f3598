"""ArduSub's GPS_RAW_INT as samples: fixes of known accuracy, each once, none under water."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav
from test_ardusub import Bench

from autopilot.core.geodesy import Origin, ned_from_geodetic
from autopilot.core.samples import GpsSample
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.ardusub_telemetry import ArduSubTelemetry
from autopilot.sitl.scenario import load_scenario


def fixes(*messages: Any) -> list[Any]:
    """Samples of messages that come one after the other."""
    driver = ArduSubTelemetry(load_vehicle("bluerov2"), density_kg_m3=998.0, depth_sigma_m=0.01, ground_pa=None)
    return [sample for n, message in enumerate(messages) for sample in driver.take(1_000_000 + 200_000 * n, message)]


def gps(time_us: int = 1, fix_type: int = 3, eph: int = 90, **more: int) -> Any:
    return mav.MAVLink_gps_raw_int_message(
        time_us, fix_type, 520_110_000, 43_570_000, 1500, eph, 65535, 0, 65535, 9, **more
    )


def test_a_fix_has_the_receivers_accuracy() -> None:
    (sample,) = fixes(gps(h_acc=1200))
    assert (sample.lat_deg, sample.lon_deg, sample.alt_m) == pytest.approx((52.011, 4.357, 1.5))
    assert sample.sigma_m == pytest.approx(1.2)
    assert sample.t_us == 800_000, "its latency"
    (diluted,) = fixes(gps(eph=150))
    assert diluted.sigma_m == pytest.approx(4.5), "3 m times the dilution of precision"


def test_what_says_nothing_is_no_sample() -> None:
    assert fixes(gps(fix_type=2, h_acc=1200), gps(eph=65535)) == []
    assert len(fixes(gps(7, h_acc=1200), gps(7, h_acc=1200), gps(8, h_acc=1200))) == 2, "the same one again"


def test_the_emulated_receiver_has_fixes_at_the_surface_only() -> None:
    bench = Bench({"GPS1_TYPE": 1.0})
    try:
        bench.run(2.0)
        assert not any(isinstance(sample, GpsSample) for sample in bench.samples), "0.6 m deep"
        truth = bench.world.truth
        surfaced = replace(truth, pos_ned_m=np.array([4.0, -3.0, 0.05]))
        for _ in range(200):
            bench.t_us += 10_000
            for data in bench.below.step(bench.t_us, surfaced):
                bench.wire.send(data)
            bench.samples += bench.driver.poll(bench.t_us)
            for received in bench.wire.recv(bench.t_us):
                bench.below.receive(bench.t_us, received.data)
        found = [sample for sample in bench.samples if isinstance(sample, GpsSample)]
        assert 8 <= len(found) <= 11
        place = load_scenario("open-water").origin
        origin = Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_m=place.alt_m)
        local = ned_from_geodetic(origin, found[-1].lat_deg, found[-1].lon_deg, 0.0)
        assert np.abs(local[:2] - [4.0, -3.0]).max() < 4.0 * found[-1].sigma_m
    finally:
        bench.close()
