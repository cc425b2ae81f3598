"""Surface waves: the theory's identities, what the plant and the pressure sensor feel, what is refused."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_helpers import VEHICLE

from autopilot.core.errors import ConfigError
from autopilot.sitl.backend import simulated_vehicle
from autopilot.sitl.plant import Plant, build_plant
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.scenario_tables import Waves
from autopilot.sitl.simulated_waters import SimulatedWaters, water_field
from autopilot.sitl.sitl_tuning import PLANT
from autopilot.sitl.waves import WithWaves, wave_number, wave_train

TEXT = """
[scenario]
name = "sea"
description = "Waves"
[vehicle]
start_m = [0.0, 0.0, 3.0]
[sensors]
position = "pose"
[sensors.depth]
sigma_m = 0.0
bias_m = 0.0
drift_m_rts = 0.0
outlier_probability = 0.0
drop_probability = 0.0
latency_jitter_s = 0.0
[waves]
height_m = 0.4
period_s = 4.0
direction_rad = 0.7
"""

DEPTHS = st.one_of(st.none(), st.floats(0.5, 60.0))
SEAS = st.builds(
    Waves,
    height_m=st.floats(0.01, 2.0),
    period_s=st.floats(1.0, 15.0),
    direction_rad=st.floats(-3.2, 3.2),
    phase_rad=st.floats(-3.2, 3.2),
    spectrum=st.sampled_from(("regular", "jonswap")),
)


def field_of(table: Waves, depth_m: float | None) -> WithWaves:
    waves = wave_train(table, depth_m)
    assert waves is not None
    return WithWaves(field=SimulatedWaters().current, waves=waves)


@given(omega=st.floats(0.2, 8.0), depth_m=st.floats(0.2, 200.0))
def test_the_wave_number_solves_the_dispersion_relation(omega: float, depth_m: float) -> None:
    k = wave_number(omega, depth_m)
    assert PLANT.gravity_m_s2 * k * math.tanh(k * depth_m) == pytest.approx(omega**2, rel=1e-9)
    assert k >= omega**2 / PLANT.gravity_m_s2 * (1.0 - 1e-9), "a bottom makes waves shorter"


@settings(max_examples=40)
@given(table=SEAS, depth_m=DEPTHS, north=st.floats(-9, 9), east=st.floats(-9, 9), share=st.floats(0.05, 0.9))
def test_gradient_and_rate_are_those_of_the_velocity_and_no_water_is_lost(
    table: Waves, depth_m: float | None, north: float, east: float, share: float
) -> None:
    field, t_s, h = field_of(table, depth_m), 7.3, 1e-5
    at = (north, east, share * (10.0 if depth_m is None else depth_m))

    def slope(axis: int) -> np.ndarray:
        step = np.eye(4)[axis] * h
        ahead = np.array(field.velocity(np.array(at) + step[:3], t_s + step[3]))
        return (ahead - np.array(field.velocity(np.array(at) - step[:3], t_s - step[3]))) / (2.0 * h)

    by_north, by_east, by_depth, by_time = (slope(axis) for axis in range(4))
    scale = table.height_m / 2.0 * (2.0 * math.pi * 3.0 / table.period_s) ** 2
    near = {"abs": 1e-4 * scale + 1e-9}
    nn, ne, en, ee = field.gradient(at, t_s)
    assert (nn, en) == pytest.approx(tuple(by_north[:2]), **near)
    assert (ne, ee) == pytest.approx(tuple(by_east[:2]), **near)
    assert field.rate(at, t_s) == pytest.approx(tuple(by_time), **near)
    assert nn + ee + by_depth[2] == pytest.approx(0.0, **near)


@given(table=SEAS, depth_m=st.floats(0.5, 60.0))
def test_nothing_flows_through_the_floor_and_the_pressure_fades_with_depth(table: Waves, depth_m: float) -> None:
    field = field_of(table, depth_m)
    assert field.velocity((1.0, 2.0, depth_m), 3.0)[2] == pytest.approx(0.0, abs=1e-9)
    assert field.waves.pressed_m((1.0, 2.0, 0.0), 3.0) == pytest.approx(field.waves.elevation_m((1.0, 2.0, 0.0), 3.0))
    for each in field.waves.components:
        crest = (each.omega_rad_s * 3.0 + each.phase_rad) / each.k_1_m
        under = [each.pressed_m((each.north * crest, each.east * crest, z), 3.0) for z in (0.0, 0.5 * depth_m, depth_m)]
        assert each.amplitude_m == pytest.approx(under[0])
        assert under[0] >= under[1] >= under[2] > -1e-12


def test_in_deep_water_it_decays_by_exp_of_kz() -> None:
    """4 s: 25 m long; half a length down only 4 % are left."""
    field = field_of(Waves(height_m=0.4, period_s=4.0), None)
    length = 2.0 * math.pi / wave_number(2.0 * math.pi / 4.0, math.inf)
    assert length == pytest.approx(PLANT.gravity_m_s2 * 16.0 / (2.0 * math.pi))
    assert field.velocity((0.0, 0.0, 0.0), 0.0)[0] == pytest.approx(0.2 * 2.0 * math.pi / 4.0)
    assert field.velocity((0.0, 0.0, length / 2.0), 0.0)[0] == pytest.approx(
        math.exp(-math.pi) * 0.2 * 2.0 * math.pi / 4.0
    )


def test_an_irregular_sea_has_its_significant_height() -> None:
    waves = wave_train(Waves(height_m=1.0, period_s=6.0, spectrum="jonswap"), None)
    assert waves is not None
    heights = [waves.elevation_m((0.0, 0.0, 0.0), 0.5 * n) for n in range(8000)]
    assert 4.0 * np.std(heights) == pytest.approx(1.0, rel=0.05)
    other = wave_train(Waves(height_m=1.0, period_s=6.0, spectrum="jonswap", seed=2), None)
    assert other is not None and other.elevation_m((0.0, 0.0, 0.0), 1.0) != waves.elevation_m((0.0, 0.0, 0.0), 1.0)


def written(folder: Path, text: str = TEXT) -> str:
    path = folder / "sea.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_neutral_hull_goes_round_with_the_water(tmp_path: Path) -> None:
    """Orbits of linear theory: radius a exp(-k z)."""
    scenario = load_scenario(written(tmp_path))
    field = water_field(scenario)
    start = field.velocity((0.0, 0.0, 3.0), 0.0)
    body = VEHICLE.body
    loose = Plant(VEHICLE, SimulatedWaters(current=field), start_pos_ned_m=(0.0, 0.0, 3.0), start_vel_frd_m_s=start)
    places, relative = [], []
    for t_us in range(10_000, 8_000_001, 10_000):
        loose.advance(t_us, (1500,) * 4)
        places.append(loose.truth.pos_ned_m)
        relative.append(loose.truth.vel_water_frd_m_s)
    ahead = np.array(places) @ np.array([math.cos(0.7), math.sin(0.7), 0.0])
    radius = 0.2 * math.exp(-wave_number(2.0 * math.pi / 4.0, math.inf) * 3.0)
    assert np.ptp(ahead) / 2.0 == pytest.approx(radius, rel=0.1)
    assert np.abs(np.array(relative)[:, :2]).max() < 0.15 * 0.2 * 2.0 * math.pi / 4.0
    assert body.buoyancy_excess_n > 0.0  # it rises meanwhile


def test_the_pressure_sensor_takes_a_crest_for_depth(tmp_path: Path) -> None:
    scenario = load_scenario(
        written(tmp_path, TEXT.replace("start_m = [0.0, 0.0, 3.0]", "start_m = [0, 0, 3]\nheld = true"))
    )
    waves = wave_train(scenario.waves, None)
    assert waves is not None
    from autopilot.core.samples import DepthSample
    from autopilot.core.vehicle import load_vehicle

    vehicle = load_vehicle("lbv150")
    device = simulated_vehicle(scenario, vehicle, position="pose")
    found = []
    with device:
        device.open()
        for t_us in range(0, 4_000_001, 10_000):
            device.advance(t_us)
            found += [s for s in device.poll(t_us) if isinstance(s, DepthSample)]
    z_m = 3.0 + vehicle.depth_sensor.position_frd_m[2]
    reads = [sample.depth_m - z_m for sample in found]
    assert max(reads) == pytest.approx(0.2 * math.exp(-wave_number(math.pi / 2.0, math.inf) * z_m), rel=0.02)
    assert min(reads) == pytest.approx(-max(reads), rel=0.05)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("height_m = 4.0", r"`\$\.waves\.height_m` = 4 breaks: waves of 4 s are 3\.5 m high at most there"),
        ("height_m = -0.4", r">= 0\.0 - at `\$\.waves\.height_m`"),
        ('height_m = 0.4\nspectrum = "swell"', "use one of jonswap, regular"),
        ("height_m = 0.4\nlength_m = 3.0", "use one of height_m, period_s, direction_rad"),
    ],
)
def test_waves_that_are_none_are_refused(tmp_path: Path, line: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build_plant(load_scenario(written(tmp_path, TEXT.replace("height_m = 0.4", line))), VEHICLE)


def test_without_waves_nothing_changes(tmp_path: Path) -> None:
    calm = load_scenario(written(tmp_path, TEXT.replace("height_m = 0.4", "height_m = 0.0")))
    assert water_field(calm).steady_uniform
    assert wave_train(None, 1.0) is None
