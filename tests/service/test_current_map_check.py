"""A current map that does not serve the workspace: plan refused, arming refused, the operator told."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from autopilot.analysis.flow_maps import b6_map, flow_map_bytes, forecast_of
from autopilot.cli.main import cli
from autopilot.command.change_watch import ChangeWatch
from autopilot.command.commander import Commander
from autopilot.command.map_check import MapCheck, parse_utc
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.control.current.current_map import CurrentMap
from autopilot.control.current.map_reading import load_current_map
from autopilot.core.errors import ConfigError
from autopilot.core.messages import Severity
from autopilot.core.origin_params import params_origin
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanKind
from autopilot.core.vehicle import load_vehicle
from autopilot.mavlink.api import CommandResult
from autopilot.mission.goals import Goals
from autopilot.mission.paper import paper_plan
from autopilot.mission.store import Plans
from autopilot.sitl.grid_current import GridField, read_grid
from autopilot.sitl.scenario import scenario_path
from tests.plan_items import nav

NORTH, EAST = np.linspace(-3.0, 3.0, 25), np.linspace(-2.0, 2.0, 17)


def _water(path: Path, *, half: float = 1.0, gap: tuple[float, float] | None = None, speed: float = 0.1) -> CurrentMap:
    u = np.full((25, 17), speed)
    if gap is not None:
        u[np.abs(NORTH - gap[0]).argmin(), np.abs(EAST - gap[1]).argmin()] = np.nan
    np.savez(path, north_m=half * NORTH, east_m=half * EAST, current_north_m_s=u, current_east_m_s=0.0 * u)
    return load_current_map(path)


def _plans(water: CurrentMap, params: ParamSet) -> Plans:
    return Plans(params, load_vehicle("lbv150").radius_m, None, MapCheck(water, params_origin(params)))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"half": 0.5}, r"current map m\.npz: does not cover north -?\d+\.\d, east -?\d+\.\d m; use a larger map"),
        (
            {"gap": (0.5, 0.5)},
            r"current map m\.npz: fill values at north 0\.\d, east 0\.\d m in the",
        ),
    ],
)
def test_a_fence_or_mission_that_the_map_does_not_serve_is_not_flown(
    tmp_path: Path, change: dict[str, object], reason: str
) -> None:
    params = ParamSet()
    plans = _plans(_water(tmp_path / "m.npz", **change), params)  # type: ignore[arg-type]
    plan = paper_plan()
    assert plans.replace(PlanKind.FENCE, plan.fence) is None
    assert re.match(reason, plans.problem)
    assert plans.items(PlanKind.FENCE) is plan.fence


def test_gaps_outside_the_workspace_and_in_obstacles_do_not_matter(tmp_path: Path) -> None:
    params = ParamSet()
    # The tank ends at 2.5 and 1.5 m; a cell is 0.25 m.
    plans = _plans(_water(tmp_path / "m.npz", gap=(3.0, 2.0)), params)
    assert plans.replace(PlanKind.FENCE, paper_plan().fence) is None
    assert plans.replace(PlanKind.MISSION, paper_plan().mission) is None
    assert plans.warnings() == ()


def test_what_the_map_leaves_of_a_leg_is_told_at_the_upload(tmp_path: Path) -> None:
    """0.46 of 0.5 m/s towards north: the way back from B to A is upstream, the way there is not."""
    plans = _plans(_water(tmp_path / "m.npz", speed=0.46), ParamSet())
    assert plans.replace(PlanKind.FENCE, paper_plan().fence) is None
    assert plans.replace(PlanKind.MISSION, paper_plan().mission) is None
    (text,) = plans.warnings()
    assert re.fullmatch(r"Item 2 is upstream: 0\.0[34]\d m/s left, \d+ (min|s) \(by current map m\.npz\)", text), text


def test_in_open_water_the_legs_have_to_be_on_the_map_and_arming_is_refused_without(tmp_path: Path) -> None:
    params, vehicle = ParamSet(), load_vehicle("lbv150")
    plans = _plans(_water(tmp_path / "m.npz", half=0.5), params)
    assert plans.replace(PlanKind.MISSION, paper_plan().mission) is None
    assert "does not cover" in plans.problem
    # The plan was there first and the origin of a map of latitudes has moved since: arming says so.
    nodes = replace(_water(tmp_path / "n.npz").nodes, geodetic=True)
    plans = _plans(CurrentMap(nodes), params)
    assert plans.replace(PlanKind.FENCE, paper_plan().fence) is None
    commander = Commander(vehicle, params, plans)
    commander.step(VehicleStatus(t_us=0, nav=nav(-1.0, 0.5, 0.5, t_us=0), ahrs_age_s=0.01))
    assert commander.arm(False).result is CommandResult.ACCEPTED
    commander.disarm(False)
    moved = replace(plans.origin, lat_deg=plans.origin.lat_deg + 0.01)
    assert plans.set_origin(moved) is None
    assert "placed about another origin" in plans.problem
    commander.step(VehicleStatus(t_us=9, nav=nav(-1.0, 0.5, 0.5, t_us=9), ahrs_age_s=0.01))
    assert "placed about another origin" in commander.arm(False).reason


def test_arming_is_refused_when_parameters_make_the_map_too_small(tmp_path: Path) -> None:
    """A gap at depth only matters once the depth band reaches it."""
    params, vehicle = ParamSet(), load_vehicle("lbv150")
    u = np.full((3, 25, 17), 0.1)
    u[2, 12, 12] = np.nan
    np.savez(
        tmp_path / "m.npz",
        depth_m=[0.0, params["DEPTH_MAX"], params["DEPTH_MAX"] + 1.0],
        north_m=NORTH,
        east_m=EAST,
        current_north_m_s=u,
        current_east_m_s=u,
    )
    plans = _plans(load_current_map(tmp_path / "m.npz"), params)
    assert plans.replace(PlanKind.FENCE, paper_plan().fence) is None
    commander = Commander(vehicle, params, plans)
    commander.step(VehicleStatus(t_us=0, nav=nav(-1.0, 0.5, 0.5, t_us=0), ahrs_age_s=0.01))
    assert commander.prearm_reasons() == ()
    params.set("DEPTH_MAX", params["DEPTH_MAX"] + 0.5)
    answer = commander.arm(False)
    assert answer.result is CommandResult.DENIED
    assert "current map m.npz: fill values at" in answer.reason


def test_water_faster_than_the_vehicle_is_said_when_the_fence_arrives(tmp_path: Path) -> None:
    params, vehicle = ParamSet(), load_vehicle("lbv150")
    plans = _plans(_water(tmp_path / "m.npz", speed=0.8), params)
    watch = ChangeWatch(vehicle, plans, Goals(vehicle, params, plans))
    assert plans.replace(PlanKind.FENCE, paper_plan().fence) is None
    conditions = VehicleStatus(t_us=0, nav=None, ahrs_age_s=0.01)
    texts = watch.update(conditions, armed=False)
    assert (
        Severity.WARNING,
        "Current map m.npz: up to 0.80 m/s, the vehicle swims 0.5: goals may be out of reach",
    ) in texts


def test_the_command_says_what_a_map_holds_and_whether_it_fits(tmp_path: Path) -> None:
    runner, plan = CliRunner(), str(scenario_path("paper-tank").parent / "paper.plan")
    for name, kwargs, code, text in (
        ("good.npz", {}, 0, "rms speed"),
        ("small.npz", {"half": 0.5}, 1, "does not cover"),
        ("fast.npz", {"speed": 0.8}, 3, "the vehicle swims"),
    ):
        _water(tmp_path / name, **kwargs)  # type: ignore[arg-type]
        result = runner.invoke(cli, ["currents", "check", str(tmp_path / name), "--plan", plan])
        assert result.exit_code == code
        assert text in result.output


def test_the_start_is_a_time() -> None:
    assert parse_utc("2026-05-01T12:00").isoformat() == "2026-05-01T12:00:00+00:00"
    with pytest.raises(ConfigError, match="'noon' is not a time"):
        parse_utc("noon")


def test_b6_is_free_of_divergence_has_its_eddies_and_is_the_same_for_truth_and_map(tmp_path: Path) -> None:
    flow = b6_map()
    forecast = forecast_of(flow, error=0.2, rng=np.random.default_rng(1))
    for each in (flow, forecast):
        u, v = each.current_north_m_s, each.current_east_m_s
        out = (u[:, 1:, 1:] + u[:, 1:, :-1] - u[:, :-1, 1:] - u[:, :-1, :-1]) + (
            v[:, 1:, 1:] + v[:, :-1, 1:] - v[:, 1:, :-1] - v[:, :-1, :-1]
        )
        assert np.abs(out).max() < 1e-12
    wrong = np.hypot(
        forecast.current_north_m_s - flow.current_north_m_s, forecast.current_east_m_s - flow.current_east_m_s
    )
    assert np.sqrt((wrong**2).mean()) == pytest.approx(0.2 * flow.rms_m_s)
    # 30 m beside the middle of the first eddy it adds its whole 0.2 m/s to the mean flow of 0.1 (sense: north to east).
    at = np.argmin(np.abs(flow.north_m - 130.0)), np.argmin(np.abs(flow.east_m - 45.0))
    assert flow.current_north_m_s[0][at] == pytest.approx(0.10 + 0.2, abs=0.01)
    (tmp_path / "b6.npz").write_bytes(flow_map_bytes(flow))
    (tmp_path / "again.npz").write_bytes(flow_map_bytes(b6_map()))
    assert (tmp_path / "b6.npz").read_bytes() == (tmp_path / "again.npz").read_bytes()
    field, water = GridField(read_grid(str(tmp_path / "b6.npz"))), load_current_map(tmp_path / "b6.npz")
    rng = np.random.default_rng(2)
    pos, t_s = rng.uniform((-10.0, -10.0, 0.0), (410.0, 210.0, 3.0), (60, 3)), rng.uniform(-50.0, 2600.0, 60)
    truth = np.array([field.velocity(tuple(p), t) for p, t in zip(pos, t_s, strict=True)])
    np.testing.assert_allclose(water.velocity(pos, t_s), truth, atol=1e-12)
