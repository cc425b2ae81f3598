"""Parts by name: what is found, where it is from, and one line for everything that is wrong."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from autopilot.control.current.currents import NoCurrent
from autopilot.control.path.workers import BackgroundWorkers
from autopilot.control.protocol import Controller, ControllerContext, create_controller
from autopilot.core.errors import ConfigError
from autopilot.core.plugins import find_plugin
from autopilot.core.shipped_parts import SHIPPED_PARTS
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator.create import create_estimator
from autopilot.run.config import chosen_part, gather, sitl_defaults
from autopilot.sitl.protocol import PlantContext, create_plant
from autopilot.sitl.scenario import load_scenario

VEHICLE = load_vehicle("lbv150")
WRITTEN = "lab_written"
"""Module that tests write."""


def context() -> ControllerContext:
    return ControllerContext(vehicle=VEHICLE, model=VEHICLE.to_model(), currents=NoCurrent(), desks=BackgroundWorkers())


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Writes a module that Python finds."""
    monkeypatch.syspath_prepend(str(tmp_path))
    sys.modules.pop(WRITTEN, None)
    yield lambda text: (tmp_path / f"{WRITTEN}.py").write_text(text) and None
    sys.modules.pop(WRITTEN, None)


HEAD = "from autopilot.control.protocol import Controller, simple_output\nimport numpy as np\n"
GOOD = f"""{HEAD}
class Quiet(Controller):
    def __init__(self, given): self.given = given
    def step(self, t_us, nav, goal, fence, params, thruster_limit_n, tracks, *, delay_s):
        return simple_output(t_us, nav, np.zeros(len(thruster_limit_n)))

def make(given): return Quiet(given)
"""


@pytest.mark.parametrize("spec", [f"{WRITTEN}:Quiet", f"{WRITTEN}:make"])
def test_a_class_or_a_function_of_any_module(lab: Callable[[str], None], spec: str) -> None:
    lab(GOOD)
    found = find_plugin("controller", spec)
    assert (found.name, found.target, found.version) == (spec, spec, "")
    assert len(found.sha256) == 64
    made = create_controller(spec, context())
    assert made.tick(0, None) is None and made.take_news() == [] and not made.unreachable  # type: ignore[arg-type]


def test_an_installed_package_offers_a_name_and_its_version_is_kept(lab: Callable[[str], None], tmp_path: Path) -> None:
    lab(GOOD)
    info = tmp_path / "my_lab-1.2.3.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-lab\nVersion: 1.2.3\n")
    (info / "entry_points.txt").write_text(
        f"[underwater_autopilot.controllers]\nquiet = {WRITTEN}:Quiet\nnmpc = {WRITTEN}:Quiet\n"
    )
    found = find_plugin("controller", "quiet")
    assert (found.target, found.version) == (f"{WRITTEN}:Quiet", "my-lab 1.2.3")
    assert type(create_controller("quiet", context())).__name__ == "Quiet"
    # What ships under a name stays what it is.
    assert find_plugin("controller", "nmpc").target == SHIPPED_PARTS["controller"]["nmpc"]
    with pytest.raises(ConfigError, match=r"'loud' is not known; use one of nmpc, los-pid, quiet, or package:Class"):
        find_plugin("controller", "loud")


METHODS = "def step(self, t_us, nav, goal, fence, params, thruster_limit_n, tracks, *, delay_s): ..."
WRONG = {
    "unknown name": ("", "pid", ("is not known", "nmpc", "package:Class")),
    "no spec": ("", "lab written:Quiet", ("is not known", "package:Class")),
    "no module": ("", "nowhere_at_all:Pid", ("no module 'nowhere_at_all'", "PYTHONPATH")),
    "no module in it": (GOOD, f"{WRITTEN}.inner:Pid", ("no module", "PYTHONPATH")),
    "its own import fails": ("import nowhere_at_all\n", f"{WRITTEN}:Pid", ("'nowhere_at_all'", "install it")),
    "no Python": ("class Pid(:\n", f"{WRITTEN}:Pid", ("SyntaxError", "correct it")),
    "raises on import": ("1 / 0\n", f"{WRITTEN}:Pid", ("ZeroDivisionError", f"{WRITTEN}.py:1")),
    "no class": (GOOD, f"{WRITTEN}:Loud", ("has no 'Loud'", "after the colon")),
    "no callable": (GOOD + "x = 3\n", f"{WRITTEN}:x", ("is a int", "name a class")),
    "takes nothing": (
        HEAD + f"class C(Controller):\n    def __init__(self): ...\n    {METHODS}\n",
        f"{WRITTEN}:C",
        ("one ControllerContext", "docs/extend.md"),
    ),
    "raises": (
        HEAD + f"class C(Controller):\n    def __init__(self, given): self.x = given.speed\n    {METHODS}\n",
        f"{WRITTEN}:C",
        ("AttributeError", "speed", f"{WRITTEN}.py:4"),
    ),
    "abstract": (
        HEAD + "class C(Controller):\n    def __init__(self, given): ...\n",
        f"{WRITTEN}:C",
        ("cannot be made", "step"),
    ),
    "no member": (
        f"class C:\n    def __init__(self, given): ...\n    {METHODS}\n",
        f"{WRITTEN}:C",
        ("has no 'tick'", "inherit from autopilot.control.protocol.Controller"),
    ),
    "other signature": (
        HEAD + "class C(Controller):\n    def __init__(self, given): ...\n    def step(self, nav, goal): ...\n",
        f"{WRITTEN}:C",
        ("step() that must take (t_us, nav, goal, fence, params, thruster_limit_n, tracks, delay_s=)",),
    ),
    "no method": (
        HEAD + "class C(Controller):\n    tick = 3\n    def __init__(self, given): ...\n    " + METHODS + "\n",
        f"{WRITTEN}:C",
        ("'tick' that is no method",),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_in_one_line(lab: Callable[[str], None], name: str) -> None:
    text, spec, named = WRONG[name]
    lab(text)
    with pytest.raises(ConfigError) as raised:
        create_controller(spec, context(), "AUTOPILOT_CONTROLLER")
    line = str(raised.value)
    assert line.startswith(f"AUTOPILOT_CONTROLLER {spec!r}") and "\n" not in line
    for part in named:
        assert part in line


def test_estimator_and_plant_are_named_by_their_options() -> None:
    with pytest.raises(
        ConfigError, match=r"--estimator 'ukf' is not known; did you mean ekf\? use one of ekf, complementary, or"
    ):
        create_estimator("ukf", VEHICLE, None)
    given = PlantContext(scenario=load_scenario("open-water"), vehicle=VEHICLE, seed=1)
    with pytest.raises(ConfigError, match=r"--plant 'gazebo' is not known; use one of rigid-body, or package:Class"):
        create_plant("gazebo", given)


def test_option_before_variable_before_scenario() -> None:
    def chosen(given: dict[str, str], environment: dict[str, str]) -> tuple[str, str]:
        return chosen_part(gather(sitl_defaults(0), given, environment), "controller", "theirs:C")

    assert chosen({}, {}) == ("theirs:C", "paper-tank: `$.plugins.controller`")
    assert chosen({}, {"AUTOPILOT_CONTROLLER": "mine:C"}) == ("mine:C", "AUTOPILOT_CONTROLLER")
    assert chosen({"controller": "now:C"}, {"AUTOPILOT_CONTROLLER": "mine:C"}) == ("now:C", "--controller")


def test_the_shipped_controller_keeps_its_protocol() -> None:
    made: Controller = create_controller("nmpc", context())
    assert not made.unreachable
    assert any(made.solver in text for _, text in made.take_news())
    assert made.take_news() == []
