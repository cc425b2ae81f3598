"""Scenario files: the shipped ones are good, wrong ones are refused with the name of the key."""

import re
from pathlib import Path

import pytest
from plant_helpers import VEHICLE

from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import load_vehicle
from autopilot.sitl.mismatch import MISMATCH_KEYS, mismatched
from autopilot.sitl.plant import build_plant
from autopilot.sitl.scenario import load_scenario, plan_path, scenario_names, scenario_path

GOOD = """
[scenario]
name = "test"
description = "A tank"
plan = "test.plan"

[tank]
polygon_m = [[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]]
depth_m = 1.5

[[obstacle]]
kind = "cylinder"
center_m = [1.0, 0.0]
radius_m = 0.2

[current]
kind = "jet"
speed_m_s = 0.2

[vehicle]
start_m = [-1.0, 0.0, 0.5]
mismatch = { mass = 1.2, drag = 0.8 }

[sensors.ahrs]
rate_hz = 50.0

[[fault]]
kind = "thruster_loss"
at_s = 10.0
thruster = "port"
loss = 0.5
"""


def load(folder: Path, text: str) -> None:
    path = folder / "test.toml"
    path.write_text(text, encoding="utf-8")
    load_scenario(str(path))


@pytest.mark.parametrize("name", scenario_names())
def test_shipped_scenarios_load_and_the_vehicle_starts_free(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.scenario.name == name
    plant = build_plant(scenario, load_vehicle(scenario.vehicle.model))
    plant.advance(1_000_000, (0,) * 8)
    assert plant.truth.contact_count == 0
    assert tuple(plant.truth.pos_ned_m) == scenario.vehicle.start_m


def test_the_shipped_set() -> None:
    expected = {"paper-tank", "paper-tank-still", "open-water", "vortex", "harbour", "narrow-gap", "b1", "pool"}
    assert expected <= set(scenario_names())


def test_the_paper_tank_is_the_papers() -> None:
    scenario = load_scenario("paper-tank")
    assert scenario.tank is not None
    assert scenario.tank.depth_m == 1.5
    assert [(o.center_m, o.radius_m) for o in scenario.obstacle] == [((-0.625, -0.625), 0.16), ((0.9375, 0.0), 0.16)]
    assert scenario.current.speed_m_s == 0.25
    assert (scenario.origin.lat_deg, scenario.origin.lon_deg) == (37.9755, 23.779)
    assert scenario.accept.cylinder_clearance_m == 0.46


def test_a_good_file_is_taken_with_defaults(tmp_path: Path) -> None:
    path = tmp_path / "test.toml"
    path.write_text(GOOD, encoding="utf-8")
    scenario = load_scenario(str(path))
    assert scenario.sensors.ahrs.rate_hz == 50.0
    assert scenario.sensors.camera.rate_hz is None
    assert scenario.controller.currents == "estimate"
    assert scenario.fault[0].at_s == 10.0
    with pytest.raises(ConfigError, match=r"test\.plan: plan file of scenario 'test' not found"):
        plan_path(str(path), scenario)
    (tmp_path / "test.plan").write_text("{}", encoding="utf-8")
    assert plan_path(str(path), scenario) == tmp_path / "test.plan"
    assert plan_path("vortex", load_scenario("vortex")) is None
    assert scenario_path("vortex").is_file()


def test_a_vortex_without_a_core_is_refused(tmp_path: Path) -> None:
    text = scenario_path("vortex").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(re.sub(r"core_m = [\d.]+", "core_m = 1e-300", text), encoding="utf-8")
    with pytest.raises(ConfigError, match=r">= 0\.001 - at `\$\.current\.core_m`"):
        load_scenario(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("depth_m = 1.5", "depth_cm = 150", r"`depth_cm` - at `\$\.tank`.*did you mean depth_m\?.*polygon_m, depth_m"),
        ("depth_m = 1.5", "", r"missing required field `depth_m` - at `\$\.tank`; add depth_m"),
        ("depth_m = 1.5", 'depth_m = "deep"', r"Expected `float`, got `str` - at `\$\.tank\.depth_m`; it is 'deep'"),
        ("depth_m = 1.5", 'depth_m = "1.5"', r"`\$\.tank\.depth_m`"),
        ("depth_m = 1.5", "depth_m = nan", r"`\$\.tank\.depth_m` = nan is not a finite number"),
        ("depth_m = 1.5", "depth_m = inf", r"`\$\.tank\.depth_m` = inf is not a finite number"),
        ("depth_m = 1.5", "depth_m = -1.5", r"> 0\.0 - at `\$\.tank\.depth_m`"),
        ("radius_m = 0.2", "radius_m = -0.2", r"> 0\.0 - at `\$\.obstacle\[0\]\.radius_m`; it is -0\.2: correct"),
        (
            "radius_m = 0.2",
            "radius_m = 0.2\ncolor = 1",
            r"`color` - at `\$\.obstacle\[0\]`.*kind, center_m, radius_m, s",
        ),
        ('kind = "cylinder"', "", "use one of cylinder, sphere, prism, moving"),
        (
            'kind = "cylinder"',
            'kind = "cylindre"',
            r"'cylindre' - at `\$\.obstacle\[0\]\.kind`.*mean cylinder\? use one of c",
        ),
        ('kind = "cylinder"', 'kind = "moving"', r"unknown field `center_m` - at `\$\.obstacle\[0\]`"),
        (
            'kind = "cylinder"\ncenter_m = [1.0, 0.0]',
            'kind = "moving"\npath_m = [[1.0, 0.5], [1.0, 0.5]]\nspeed_m_s = 0.1',
            r"`path_m` repeats the corner \[1, 0\.5\] - at `\$\.obstacle\[0\]`",
        ),
        ('kind = "jet"', 'kind = "grid"', r"`speed_m_s` - at `\$\.current`"),
        ('kind = "jet"', 'kind = "jett"', r"did you mean jet\? use one of none, uniform, jet, vortex"),
        ('kind = "thruster_loss"', 'kind = "explosion"', "use one of thruster_loss, camera_blackout, "),
        ("start_m = [-1.0, 0.0, 0.5]", "start_m = [-1.0, 0.0]", r"`\$\.vehicle\.start_m`"),
        ("mass = 1.2", "mass = -1.2", r">= 0\.0 - at `\$\.vehicle\.mismatch"),
        ("mass = 1.2", "mass = 0.0", r"`\$\.vehicle\.mismatch`: mass = 0\.0 is not a usable factor"),
        ("mass = 1.2", "weight = 1.2", r"`\$\.vehicle\.mismatch`: factor 'weight' is not known; use one of mass"),
        (
            'thruster = "port"',
            'thruster = "bow"',
            r"`\$\.fault\[0\]\.thruster`: thruster 'bow' is not known; use one of p",
        ),
        ("loss = 0.5", "loss = 1.5", r"`\$\.fault\[0\]\.loss`"),
        ("rate_hz = 50.0", "rate_hz = 0.0", r"`\$\.sensors\.ahrs\.rate_hz`"),
        (
            "[sensors.ahrs]",
            "[sensors.sonar]",
            r"`sonar` - at `\$\.sensors`.*use one of position, ahrs, camera, pose, laser",
        ),
        ("[2.5, 1.5], [-2.5, 1.5]]", "[-2.5, 1.5], [2.5, 1.5]]", r"cross - at `\$\.tank`"),
        ("[2.5, 1.5], [-2.5, 1.5]]", "[2.5, 1.5], [2.5, 1.5]]", r"repeats the corner \[2\.5, 1\.5\] - at `\$\.tank`"),
        ("[scenario]", "[scenarios]", "scenario"),
        ("[tank]", "[tank", "is not valid TOML"),
        (
            "[vehicle]",
            '[vehicle]\nmodel = "lbv999"',
            "vehicle 'lbv999' is not known; use one of bluerov2, bluerov2-heavy, l",
        ),
        # Tables that the good file does not have:
        ("[vehicle]", '[controller]\nmap = "a.npz"\n[vehicle]', '`map` needs `currents` = "map"'),
        (
            "[vehicle]",
            '[controller]\ncurrents = "guess"\n[vehicle]',
            r"`\$\.controller\.currents`.*use one of estimate, map, n",
        ),
        (
            "[vehicle]",
            '[spread."tank.depth_m"]\nlo = 1.0\n[vehicle]',
            r"did you mean low\? use one of low, high, choice",
        ),
        ("[vehicle]", "[waters]\n[vehicle]", "use one of scenario, origin, tank, "),
        ("[vehicle]", "[markers]\nsize_m = 0.1\n[vehicle]", r"`size_m` = 0\.1 must be smaller than `pitch_m`"),
        ("[vehicle]", "[accept]\ndepth_max_m = -1.0\n[vehicle]", "must be greater than `depth_min_m`"),
        ("[vehicle]", "[origin]\nlat_deg = 91.0\n[vehicle]", r"`\$\.origin\.lat_deg`"),
        ("[vehicle]", "[params]\nNO_SUCH = 1\n[vehicle]", r"`\$\.params\.NO_SUCH`.*is not known"),
        ("[vehicle]", "[params]\nMPC_COST = 7\n[vehicle]", r"`\$\.params\.MPC_COST`.*out of range"),
        (
            "[vehicle]",
            "[sensors.camera.outages]\nmax_s = 0.01\n[vehicle]",
            r"below `min_s` = 0\.1 - at `\$\.sensors\.camera\.outages`",
        ),
    ],
)
def test_a_wrong_file_is_refused_with_the_name_of_the_key_and_the_valid_ones(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in GOOD
    with pytest.raises(ConfigError, match=message) as error:
        load(tmp_path, GOOD.replace(old, new))
    lines = str(error.value).splitlines()
    assert len(lines) == 1 or (lines[0].endswith(f": {len(lines) - 1} mistakes:") and len(lines) < 4)


def test_a_camera_without_a_floor_is_refused(tmp_path: Path) -> None:
    text = GOOD.replace("[tank]", "").replace("depth_m = 1.5", "")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("polygon_m"))
    with pytest.raises(ConfigError, match=r"`\$\.sensors\.position` = \"camera\" needs a floor"):
        load(tmp_path, text)


def test_a_start_outside_the_tank_or_in_an_obstacle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "test.toml"
    for start, message in (("[3.0, 0.0, 0.5]", "outside the tank"), ("[1.1, 0.0, 0.5]", "inside obstacle 1")):
        path.write_text(GOOD.replace("[-1.0, 0.0, 0.5]", start), encoding="utf-8")
        with pytest.raises(ConfigError, match=message):
            build_plant(load_scenario(str(path)), VEHICLE)


def test_unknown_names_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"scenario 'atlantis' is not known; use one of b1, .*harbour"):
        load_scenario("atlantis")
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read"):
        load_scenario(str(tmp_path / "none.toml"))


@pytest.mark.parametrize("key", MISMATCH_KEYS)
def test_every_mismatch_factor_changes_the_vehicle_and_one_changes_nothing(key: str) -> None:
    assert mismatched(VEHICLE, {key: 1.0}) == VEHICLE
    assert mismatched(VEHICLE, {key: 1.1}) != VEHICLE


def test_mismatch_of_the_buoyancy_is_a_factor_on_the_whole_force() -> None:
    body = mismatched(VEHICLE, {"buoyancy": 1.01}).body
    assert body.buoyancy_excess_n == pytest.approx(0.6 + 0.01 * 118.3)
    assert mismatched(VEHICLE, {"mass": 1.2}).body.mass_kg == pytest.approx(14.4)
    masses = {"surge_mass": 0.8, "sway_mass": 1.2, "heave_mass": 1.1, "yaw_inertia": 0.8}
    heavy = mismatched(VEHICLE, masses).body
    hull, water = heavy.mass_kg, heavy.added_mass_kg
    assert [hull + added for added in water] == pytest.approx([0.8 * 16.5, 1.2 * 22.0, 1.1 * 22.5])
    assert heavy.inertia_kg_m2[2] + heavy.added_inertia_kg_m2[2] == pytest.approx(0.8 * 0.30)
    with pytest.raises(ConfigError, match=r"surge_mass = 0\.6 leaves less than the hull"):
        mismatched(VEHICLE, {"surge_mass": 0.6})
    with pytest.raises(ConfigError, match="factor 'colour' is not known"):
        mismatched(VEHICLE, {"colour": 1.0})
