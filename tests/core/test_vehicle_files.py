"""Vehicle files: what is wrong is told in one line, before anything moves; geometry becomes the allocation."""

import copy
import itertools
import math
import re
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.cli.main import cli, run
from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import Vehicle, checked, convert, load_vehicle, vehicle_names
from autopilot.core.vehicle_summary import facts_of, terminal_speed, tilts_of
from autopilot.sitl.toml_text import toml_text

FOLDER = resources.files("autopilot") / "data"


def tables(name: str) -> dict[str, Any]:
    return tomllib.loads((FOLDER / "vehicles" / f"{name}.toml").read_text())


def written(path: Path, made: dict[str, Any]) -> str:
    """The tables as a file; its path."""
    path.write_text(toml_text({**made, "sources": {}}))
    return str(path)


def refusal(tmp_path: Path, made: dict[str, Any]) -> str:
    with pytest.raises(ConfigError) as found:
        load_vehicle(written(tmp_path / "made.toml", made))
    text = str(found.value)
    assert "\n" not in text and "made.toml" in text
    return text


@pytest.mark.parametrize("name", vehicle_names())
def test_every_value_of_a_shipped_vehicle_has_a_source(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    assert not [line for line in facts_of(vehicle).missing if "says nothing" in line]
    assert facts_of(vehicle).contradictions == ()


def test_the_template_is_a_vehicle() -> None:
    made = tomllib.loads((FOLDER / "templates" / "vehicle.toml").read_text())
    vehicle: Vehicle = convert(made, Vehicle, "template")
    assert len(vehicle.thrusters) == 4


def test_matrices_are_the_published_ones() -> None:
    heavy = np.array(load_vehicle("bluerov2-heavy").to_model().allocation)
    c, turn = math.sqrt(0.5), math.sqrt(0.5) * (0.156 + 0.111)
    assert np.allclose(heavy[0], [c, c, -c, -c, 0, 0, 0, 0])
    assert np.allclose(heavy[1], [-c, c, -c, c, 0, 0, 0, 0])
    assert np.allclose(heavy[2], [0, 0, 0, 0, 1, 1, 1, 1])
    assert np.allclose(heavy[3], [-turn, turn, turn, -turn, 0, 0, 0, 0])
    assert load_vehicle("lbv150").to_model().allocation == (
        (1.0, 1.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 1.0),
        (0.0, 0.0, 1.0, 0.0),
        (0.12, -0.12, 0.0, 0.0),
    )


def test_what_vehicles_can_do() -> None:
    assert tilts_of(load_vehicle("lbv150")) == ()
    assert tilts_of(load_vehicle("bluerov2")) == ("roll",)
    assert tilts_of(load_vehicle("bluerov2-heavy")) == ("roll", "pitch")
    facts = facts_of(load_vehicle("lbv150"))
    assert [round(axis.authority, 2) for axis in facts.axes] == pytest.approx([24.0, 12.0, 12.0, 2.88], abs=0.011)
    assert [round(axis.speed, 2) for axis in facts.axes] == [0.83, 0.42, 0.39, 1.43]  # plant.md 2: 0.83, 0.41, -, 1.43
    assert facts.hover_w == pytest.approx(12.0 + 1.2 * 0.6**1.5)
    assert terminal_speed(8.0, 2.0, 0.0) == 4.0 and terminal_speed(-1.0, 2.0, 1.0) == 0.0


@given(force=st.floats(1e-3, 200.0), linear=st.floats(0.0, 50.0), quadratic=st.floats(1e-2, 300.0))
def test_at_the_terminal_speed_drag_is_the_force(force: float, linear: float, quadratic: float) -> None:
    speed = terminal_speed(force, linear, quadratic)
    assert linear * speed + quadratic * speed**2 == pytest.approx(force, rel=1e-6)
    assert terminal_speed(force, 0.0, 0.0) == math.inf


def _change(made: dict[str, Any], change: str) -> None:
    """Python on the tables: ``t`` the thrusters, ``d`` the drive, ``m`` everything."""
    exec(change, {"m": made, "t": made["thruster"], "d": made["drive"], "copy": copy})  # the cases below


BAD = {
    "two on one channel": ("lbv150", "t[3]['channel'] = 2", ("starboard, lateral", "`channel` = 2")),
    "two of one name": ("lbv150", "t[3]['name'] = 'port'", ("`thruster[0]` and `thruster[3]`", "'port'")),
    "channel nought": ("lbv150", "t[0]['channel'] = 0", ("channel", ">= 1")),
    "no direction": ("lbv150", "t[1]['direction_frd'] = [0.0, 0.0, 0.0]", ("direction_frd", "no direction")),
    "two thrusters": ("lbv150", "del t[2:]", ("thruster", ">= 3")),
    "nine thrusters": ("bluerov2-heavy", "t.append({**t[0], 'name': 'ninth'})", ("thruster", "<= 8")),
    "no vertical": ("lbv150", "t[2]['direction_frd'] = [0.0, 1.0, 0.0]", ("no thrust in heave",)),
    "no lateral": ("lbv150", "del t[3]; del m['body']['thruster_offset_frd_m']", ("no thrust in sway",)),
    "no arm": ("lbv150", "t[0]['position_frd_m'] = t[1]['position_frd_m'] = [0.0, 0.0, 0.0]", ("no thrust in yaw",)),
    "singular": ("lbv150", "t[1]['position_frd_m'] = [0.0, -0.12, 0.0]", ("no thrust in yaw alone", "surge")),
    "weak": ("lbv150", "t[2]['limit_n'] = 0.5", ("too little thrust in heave", "needs")),
    "no limit": ("lbv150", "t[2]['limit_n'] = 0.0", ("limit_n", "> 0")),
    "coefficient nought": ("lbv150", "d['forward_n_v2'] = 0.0", ("forward_n_v2", "> 0")),
    "mass below nought": ("bluerov2", "m['model4']['mass_kg'][1] = -1.0", ("model4.mass_kg", "> 0")),
    "brushed without c": ("lbv150", "del d['reverse_n_v2']", ("brushed", "reverse_n_v2")),
    "curve without curve": ("bluerov2", "del d['curve']", ("[[drive.curve]]",)),
    "both laws": ("bluerov2", "d['deadband_duty'] = 0.1", ("curve", "deadband_duty")),
    "falling": ("bluerov2", "d['curve'][2]['thrust_n'][-1] = 1.0", ("thrust_n[39]", "not monotonic")),
    "pulses back": ("bluerov2", "d['curve'][0]['pulse_us'][3] = 1100", ("pulse_us[3]", "not monotonic")),
    "lengths": ("bluerov2", "d['curve'][0]['pulse_us'].append(1950)", ("41 of `pulse_us` and 40 of `thrust_n`",)),
    "no deadband": ("bluerov2", "d['neutral_us'] = 1450; d['span_us'] = 300", ("wrong side",)),
    "short curve": ("bluerov2", "d['span_us'] = 450", ("1050 to 1950",)),
    "voltages": ("bluerov2", "d['curve'].reverse()", ("supply_v", "rises")),
    "old allocation": ("lbv150", "m['model4']['allocation'] = [[1.0]]", ("`allocation`", "model4")),
    "offset of nobody": ("lbv150", "m['body']['thruster_offset_frd_m'] = {'bow': [0.0, 0.0, 0.1]}", ("'bow'",)),
    "centre beside the picture": ("lbv150", "m['camera']['center_px'][1] = 700.0", ("center_px[1]", "700", "pixels")),
    "centre of a part": ("bluerov2", "m['camera']['center_px'][0] = -3.0", ("center_px[0]", "-3", "use 0 to")),
    "focal length in metres": ("lbv150", "m['camera']['focal_px'] = [0.8, 0.8]", ("focal_px[0]", "0.8", "use ")),
    "size of the sensor": ("bluerov2", "m['camera']['width_px'] = 64000", ("focal_px", "64000 x ")),
    "lens of a fisheye": (
        "lbv150",
        "m['camera']['distortion'] = [0.05, -0.01, 0.3, -0.5, 0.0]",
        ("k1 k2 p1 p2",),
    ),
    "lens swapped": ("lbv150", "m['camera']['distortion'] = [-2.0, 0.0, 0.0, 0.0, 0.0]", ("distortion", "folds")),
    "laser in the lens": (
        "lbv150",
        "m['laser']['position_frd_m'] = [0.0, 0.0, 0.0]",
        ("laser.position_frd", "range"),
    ),
    "levelling nought": ("bluerov2", "m['levelling']['inertia_kg_m2'] = [0.0, 1.0]", ("inertia_kg_m2", "> 0")),
}


@pytest.mark.parametrize("name", BAD)
def test_mistakes_are_told_in_one_line(tmp_path: Path, name: str) -> None:
    like, change, says = BAD[name]
    made = tables(like)
    _change(made, change)
    text = refusal(tmp_path, made)
    assert all(part in text for part in says), text


CONTRADICTIONS = {
    "body.buoyancy_excess_n": (500.0, "0.6 of model4 and 500 of body"),
    "model4.buoyancy_excess_n": (-0.6, "-0.6 of model4 and 0.6 of body"),
    "body.weight_n": (12.0, "body.weight_n = 12 and body.mass_kg times 9.81 = 117.7"),
    "model4.mass_kg": ([16.5, 220.0, 22.5, 0.3], "model4.mass_kg[1] = 220 and body.mass_kg and what is added = 22"),
    "model4.dry_mass_kg": (1.2, "model4.dry_mass_kg = 1.2 and body.mass_kg = 12"),
    "model4.quadratic_drag": ([300.0, 55.0, 60.0, 1.2], "model4 at 0.3 m/s: drag[0] = 28.2 and body's = 3.9"),
    "body.center_of_buoyancy_frd_m": ([0.0, 0.0, 0.03], "center_of_buoyancy_frd_m[2] = 0.03 is below"),
}


@pytest.mark.parametrize("key", CONTRADICTIONS)
def test_tables_that_describe_two_vehicles_are_told(
    tmp_path: Path, key: str, capsys: pytest.CaptureFixture[str]
) -> None:
    made = tables("lbv150")
    table, name = key.split(".")
    made[table][name], told = CONTRADICTIONS[key]
    (line,) = facts_of(load_vehicle(path := written(tmp_path / "made.toml", made))).contradictions
    assert told in line
    assert run(lambda: cli(["vehicle", "check", path], standalone_mode=False)) == 3
    assert f"warning: {line}" in capsys.readouterr().err


OTHER_UNITS = {
    "camera.mounting_rpy_rad": [0.0, 0.0, 90.0],
    "camera.position_frd_m": [0.0, 0.0, 100.0],
    "camera.latency_s": 60.0,
    "camera.time_offset_s": -60.0,
    "camera.time_offset_sigma_s": 5.0,
    "camera.rate_hz": 0.033,
    "camera.focal_sigma": 2.0,
    "camera.mounting_sigma_rad": [2.0, 2.0, 2.0],
    "camera.position_sigma_m": [5.0, 5.0, 5.0],
    "laser.position_frd_m": [0.0, 50.0, 100.0],
    "ahrs.latency_s": 15.0,
    "ahrs.rate_hz": 0.01,
    "depth_sensor.position_frd_m": [0.0, 0.0, -40.0],
    "dvl.heading_sigma_rad": 2.0,
    "radius_m": 300.0,
    "hull_radius_m": 27.0,
    "body.center_of_buoyancy_frd_m": [0.0, 0.0, -20.0],
    "tether.diameter_m": 7.6,
    "battery.internal_resistance_ohm": 50.0,
    "drive.time_constant_s": 150.0,
    "drive.command_timeout_s": 500.0,
    "drive.span_us": 4000,
    "drive.power_w_n15": 1e-320,
    "drive.reverse_power_w_n15": 1200.0e3,
}


@pytest.mark.parametrize("key", OTHER_UNITS)
def test_a_number_in_another_unit_is_refused_with_the_range(tmp_path: Path, key: str) -> None:
    made = tables("lbv150")
    *parts, name = key.split(".")
    table = made.setdefault(parts[0], {}) if parts else made
    table[name] = OTHER_UNITS[key]
    text = refusal(tmp_path, made)
    assert key in text and ("<=" in text or ">=" in text), text


def test_order_does_not_matter(tmp_path: Path) -> None:
    made = tables("lbv150")
    for order in itertools.islice(itertools.permutations(range(4)), 0, 24, 5):
        other = {**made, "thruster": [made["thruster"][i] for i in order]}
        vehicle = load_vehicle(written(tmp_path / "made.toml", other))
        columns = np.array(vehicle.to_model().allocation)
        assert np.array_equal(columns, np.array(load_vehicle("lbv150").to_model().allocation)[:, list(order)])


@given(st.integers(0, 10_000))
@settings(max_examples=60)
def test_any_geometry_is_a_vehicle_or_is_refused_with_the_axis(seed: int) -> None:
    rng = np.random.default_rng(seed)
    made = tables("lbv150")
    count, grid = int(rng.integers(3, 9)), rng.uniform() < 0.5
    made["thruster"], made["body"]["thruster_offset_frd_m"] = [], {}
    for index, channel in enumerate(rng.permutation(16)[:count].tolist()):
        way = rng.integers(-1, 2, 3) if grid else rng.normal(size=3)
        place = rng.integers(-1, 2, 3) * 0.1 if grid else rng.uniform(-0.3, 0.3, 3)
        table = {"name": f"t{index}", "position_frd_m": place.tolist(), "direction_frd": [float(x) for x in way]}
        made["thruster"].append({**table, "channel": channel + 1, "reversed": bool(rng.uniform() < 0.3)})
    try:
        vehicle = checked(convert(made, Vehicle, "made"), "made")
    except ConfigError as error:
        text = str(error)
        assert "\n" not in text
        assert any(axis in text for axis in ("surge", "sway", "heave", "yaw", "direction_frd")), text
        return
    assert all(axis.authority > 0.0 and axis.speed > 0.0 for axis in facts_of(vehicle).axes)
    assert len(vehicle.to_model().allocation[0]) == count


def test_the_service_reads_nothing_of_the_plants_tables() -> None:
    root = Path(__file__).parents[2]
    rooms = ("estimator", "mission", "drivers", "autopilot/command", "autopilot/control", "autopilot/mavlink")
    files = [file for room in rooms for file in (root / room).rglob("*.py")]
    assert len(files) > 100
    # What a battery holds and which voltages it has is printed on it: battery monitors go by that.
    plants = re.compile(r"\.(body|battery(?!\.(capacity_j|limits))|tether)\.|added_mass")
    found = [file.name for file in files if plants.search(file.read_text())]
    assert found == []


@pytest.mark.parametrize("name", vehicle_names())
def test_a_shipped_vehicle_says_which_voltages_its_battery_has_and_whence_they_are(name: str) -> None:
    vehicle = load_vehicle(name)
    battery, limits = vehicle.battery, vehicle.battery.limits
    assert (limits.min_v, limits.max_v) == battery.plausible_v
    assert (limits.low_v, limits.critical_v) == (battery.low_v, battery.critical_v)
    assert {f"battery.{key}" for key in ("plausible_v", "low_v", "critical_v")} <= set(vehicle.sources)
    assert limits.can_be(battery.open_circuit_v) and limits.can_be(battery.empty_v)
    assert not any(limits.can_be(volts) for volts in (0.3, 66.0, 65.535, math.nan))


def test_a_battery_without_limits_of_its_own_has_some(tmp_path: Path) -> None:
    made = tables("bluerov2")
    for key in ("plausible_v", "low_v", "critical_v"):
        del made["battery"][key]
    limits = load_vehicle(written(tmp_path / "made.toml", made)).battery.limits
    assert (limits.min_v, limits.max_v) == (7.0, pytest.approx(19.32))
    assert (limits.low_v, limits.critical_v) == (pytest.approx(12.6), pytest.approx(11.9))


@pytest.mark.parametrize("wrong", [{"low_v": 20.0}, {"critical_v": 14.5}, {"plausible_v": [8.0, 18.0]}, {"low_v": 5.0}])
def test_limits_of_a_battery_that_contradict_each_other_are_refused(tmp_path: Path, wrong: dict[str, Any]) -> None:
    made = tables("lbv150")
    made["battery"] |= wrong
    text = refusal(tmp_path, made)
    assert "`battery`" in text and "`plausible_v`" in text
