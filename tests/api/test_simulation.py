"""The front door: fly, step, read; what is asked for happens, and what cannot be is said."""

import gc
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import autopilot
from autopilot import Simulation, fly, open_log
from autopilot.control.protocol import Controller, simple_output
from autopilot.core.errors import AutopilotError, ConfigError
from autopilot.core.messages import ProgressState


def quick(**more: Any) -> Simulation:
    return Simulation("paper-tank", sensors="pose", **more)


def test_the_front_door_costs_nothing_until_it_is_used() -> None:
    code = (
        "import autopilot, sys; print(autopilot.__all__, [m for m in ('casadi', 'numpy', 'cv2') if m in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "['Simulation', 'fly', 'open_log'] []"
    assert set(autopilot.__all__) <= set(dir(autopilot))
    with pytest.raises(AttributeError, match="no attribute 'flie'"):
        _ = autopilot.flie  # type: ignore[attr-defined]


def test_a_flight_is_that_of_the_command_line(tmp_path: Path) -> None:
    flown = fly("paper-tank", sensors="pose", seed=5, duration_s=4.0, params={"SPD_CRUISE": 0.2})
    file = tmp_path / "cli.mcap"
    line = ["sitl", "paper-tank", "--sensors", "pose", "--seed", "5", "--duration", "4", "--param", "SPD_CRUISE=0.2"]
    more = ["--start", "--speed", "0", "--connect", "udpout:127.0.0.1:9", "--log", str(file), "--quiet"]
    subprocess.run([sys.executable, "-m", "autopilot", *line, *more], check=True, cwd=tmp_path)
    for topic in ("/sim/truth", "/out/thrusters"):
        assert np.array_equal(flown[topic], open_log(file)[topic])
    other = fly("paper-tank", sensors="pose", seed=6, duration_s=4.0, params={"SPD_CRUISE": 0.2})
    assert not np.array_equal(flown["/nav/state"]["pos_ned_m"], other["/nav/state"]["pos_ned_m"])


def test_a_log_without_a_name_lives_as_long_as_it_is_read(tmp_path: Path) -> None:
    log = fly("paper-tank", sensors="pose", duration_s=1.0)
    path = log.path
    assert path.is_file() and log.duration_s == pytest.approx(1.0, abs=0.01)
    del log
    gc.collect()
    assert not path.parent.exists()
    kept = fly("paper-tank", sensors="pose", duration_s=1.0, log=tmp_path / "kept.mcap").path
    assert kept == tmp_path / "kept.mcap" and kept.is_file()


@pytest.mark.long
def test_a_flight_ends_soon_after_its_mission() -> None:
    log = fly("paper-tank-still", sensors="pose", controller="los-pid")
    done = log["/mission/progress"]
    complete_us = done["t_us"][done["state"] == ProgressState.COMPLETE][0]
    assert 2.9 < log.duration_s - 1e-6 * complete_us < 3.2


class Still(Controller):
    """No thrust at all."""

    def __init__(self, given: Any) -> None:
        self.count = len(given.vehicle.thrusters)

    def step(self, t_us: int, nav: Any, *args: Any, **more: Any) -> Any:
        return simple_output(t_us, nav, np.zeros(self.count))


def test_a_class_is_handed_over_as_it_is() -> None:
    class Local(Still):
        pass

    assert "test_simulation:Still" in _controller_of(Still)
    assert _controller_of(Local).endswith("Local.Local")
    first = type("Local", (Still,), {"__qualname__": "nowhere.Local"})
    assert _controller_of(first).endswith("Local.Local_2"), "another class of that name is another"
    with pytest.raises(ConfigError, match="los_pid has no 'LosPit'"):
        fly("paper-tank", sensors="pose", controller="autopilot.control.los_pid:LosPit")


class EndsBadly(Still):
    def reset(self) -> None:
        raise RuntimeError("no more")


class NoMargin(Still):
    def goal_margin_m(self, params: Any) -> float:
        return float("nan")


def test_a_controller_that_fails_at_the_end_does_not_take_the_flight_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AUTOPILOT_GUARD", "")
    log = fly("paper-tank", sensors="pose", duration_s=2.5, controller=EndsBadly)
    assert log.duration_s > 2.0
    with pytest.raises(ConfigError, match=r"NoMargin: goal_margin_m\(\) returns nan; return a clearance"):
        fly("paper-tank", sensors="pose", duration_s=2.5, controller=NoMargin)


def _controller_of(part: Any) -> str:
    """The name under which the log has the controller, which has not pushed."""
    log = fly("paper-tank", sensors="pose", duration_s=2.5, controller=part)
    assert not log["/out/thrusters"]["thrust_n"].any()
    assert log.description is not None
    return log.description.parts["controller"].target


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"sensor": "pose"}, "sensor='pose' is no option of a flight; use one of vehicle, plan"),
        ({"sensors": "sonar"}, "sensors='sonar' is not known; use one of camera, pose, or leave it out"),
        ({"currents": 3}, "currents=3 is not known; use one of estimate"),
        ({"controller": "nmcp"}, "'nmcp' is not known; did you mean nmpc? use one of nmpc, los-pid, or package:Class"),
        ({"params": {"SPD_CRUSE": 0.2}}, "SPD_CRUSE"),
        ({"params": {"SPD_CRUISE": "fast"}}, "write {NAME: number}"),
        ({"params": 3}, "write {NAME: number}"),
        *(({"seed": seed}, f"seed={seed!r} is not valid; use a whole number, 0 or more") for seed in (-1, "one", 1.5)),
        ({"seed": True}, "seed=True is not valid"),
        ({"duration_s": 0.0}, "duration=0.0 is not valid; use a number of seconds above 0"),
        ({"vehicle": "lbv15"}, "lbv15"),
    ],
)
def test_what_cannot_be_is_named(options: dict[str, Any], text: str) -> None:
    with pytest.raises(AutopilotError) as caught:
        fly("paper-tank", **options)
    assert text in str(caught.value)


def test_numbers_of_numpy_are_numbers() -> None:
    given = {"seed": np.int64(7), "duration_s": np.float64(0.5)}
    log = fly("paper-tank", sensors="pose", **given)  # type: ignore[arg-type]
    assert log.run["seed"] == "7" and log.duration_s < 1.0
    assert json.loads(log.attachments["config.json"])["seed"] == 7
    with quick() as sim:
        sim.reset(np.int64(7))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [-3, 1.0, True, np.float64(2.0), "1"])
def test_a_seed_that_is_none_is_named_and_the_flight_goes_on(seed: Any) -> None:
    with quick() as sim:
        sim.reset()
        with pytest.raises(ConfigError, match="seed="):
            sim.reset(seed)
        sim.step()


def test_a_scenario_that_does_not_exist_is_named() -> None:
    with pytest.raises(ConfigError, match="paper-tonk"):
        fly("paper-tonk")
    with pytest.raises(ConfigError, match="paper-tonk"):
        Simulation("paper-tonk")


def test_thrust_acts_for_its_step_and_goals_until_the_next() -> None:
    with quick() as sim:
        begin = sim.reset(seed=2)
        assert sim.thrust_limit_n.shape == (len(sim.vehicle.thrusters),) == (4,)
        given_n = 0.5 * sim.thrust_limit_n
        for _ in range(10):
            nav, info = sim.step(given_n)
        assert np.allclose(info.thrust_n, given_n) and info.armed and info.mode == "HOLD"
        assert info.t_s == pytest.approx(1e-6 * begin.t_us + 0.5) and nav.t_us == round(1e6 * info.t_s)
        nav, info = sim.step(100.0 * given_n)
        assert (info.thrust_n <= sim.thrust_limit_n).all()
        goal = np.array([-1.4, 0.4, 0.7])
        sim.step(goal=[*goal, 0.5])
        for _ in range(300):
            nav, info = sim.step()
        assert info.mode == "GUIDED" and np.linalg.norm(info.truth.pos_ned_m - goal) < 0.05
        assert abs(info.truth.rpy_rad[2] - 0.5) < 0.1 and info.contacts == 0 and info.energy_j > 0.0


def test_a_goal_after_a_refused_one_is_flown_to() -> None:
    with quick() as sim:
        sim.reset(seed=2)
        _, info = sim.step(goal=[9.0, 9.0, 99.0])
        said = list(info.events)
        for _ in range(60):
            _, info = sim.step()
            said += info.events
        assert any("Set point refused: depth 99.00 m" in text for text in said) and info.mode == "HOLD"
        goal = [-1.4, 0.4, 0.7]
        for _ in range(300):
            _, info = sim.step(goal=goal)
        assert info.mode == "GUIDED" and np.linalg.norm(info.truth.pos_ned_m - goal) < 0.05


def test_a_mission_may_be_watched_and_pushed(tmp_path: Path) -> None:
    with quick(start=True, log=tmp_path / "run.mcap") as sim:
        sim.reset()
        info = None
        for k in range(60):
            _, info = sim.step([3.0, 3.0, 0.0, 0.0] if k > 55 else None)
        assert info is not None and info.mission is ProgressState.ACTIVE and not info.over
        first = sim.log_path
        sim.reset()
    assert first == tmp_path / "run.mcap" and sim.log_path == tmp_path / "run_2.mcap"
    log = open_log(first)
    assert not log.problems and log.duration_s > 4.0 and log.description is not None
    assert log.description.parts["controller"].name == "nmpc"


def test_steps_that_cannot_be_are_named() -> None:
    sim = quick()
    with pytest.raises(AutopilotError, match="call reset"):
        sim.step()
    sim.reset()
    for thrust in ([1.0], [np.nan, 0.0, 0.0, 0.0], "full"):
        with pytest.raises(ConfigError, match="thrust_n="):
            sim.step(thrust)  # type: ignore[arg-type]
    place = [0.0, 0.0, 0.3]
    for goal in ([1.0], [np.inf, 0.0, 0.0], [*place, np.inf], [*place, 1e300], [1e300, 0.0, 0.3], [10**400, 0.0, 0.0]):
        with pytest.raises(ConfigError, match="goal"):
            sim.step(goal=goal)
    for wrong in ("abc", "123", 1.0, [None, 0.0, 0.3], [*place, "north"], [place, place], {"north": 0.0}):
        with pytest.raises(ConfigError, match="goal"):
            sim.step(goal=wrong)  # type: ignore[arg-type]
    sim.close()
    with pytest.raises(AutopilotError, match="call reset"):
        sim.step()
    sim.close()


def test_a_vehicle_that_is_not_armed_says_why() -> None:
    with quick(params={"BATT_LOW_VOLT": 30.0, "BATT_LOW_TIMER": 0.0}) as sim, pytest.raises(AutopilotError) as caught:
        sim.reset()
    assert "not armed within" in str(caught.value) and "attery" in str(caught.value)
