"""The arrows between the rooms: data flows one way, and only the composition root sees everything."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
OURS = ("autopilot", "drivers", "estimator", "mission", "sitl")

ALLOWED: dict[str, tuple[str, ...]] = {
    "autopilot/core": ("autopilot.core",),
    "autopilot/client": ("autopilot.core", "autopilot.client"),
    "autopilot/control": ("autopilot.core", "autopilot.control"),
    "autopilot/mavlink": ("autopilot.core", "autopilot.mavlink"),
    "autopilot/log": ("autopilot.core", "autopilot.log"),
    "drivers": ("autopilot.core", "drivers"),
    "estimator": ("autopilot.core", "estimator"),
    "mission": ("autopilot.core", "mission"),
    "sitl": ("autopilot.core", "drivers", "sitl"),
}
"""Room -> what it may import of ours."""


def _imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return names


def _files(room: str) -> list[Path]:
    return sorted((ROOT / room).rglob("*.py"))


@pytest.mark.parametrize("room", ALLOWED)
def test_room_imports_only_what_it_may(room: str) -> None:
    files = _files(room)
    assert files, f"{room} is empty"
    for path in files:
        for name in _imports(path):
            if name.split(".")[0] in OURS:
                allowed = any(name == prefix or name.startswith(prefix + ".") for prefix in ALLOWED[room])
                assert allowed, f"{path.relative_to(ROOT)} imports {name}"


COMPOSITION = (
    "autopilot.bench",
    "autopilot.campaign",
    "autopilot.cli",
    "autopilot.compose",
    "autopilot.demo",
    "autopilot.describe",
)
"""What puts rooms together: nothing below may know of it."""


@pytest.mark.parametrize("part", ["commander", "failsafes", "goals", "operator", "param_file", "service", "watch"])
def test_the_service_knows_neither_simulation_nor_composition(part: str) -> None:
    for name in _imports(ROOT / "autopilot" / f"{part}.py"):
        assert name.split(".")[0] not in ("sitl", "drivers"), f"{part} imports {name}"
        assert not name.startswith(COMPOSITION), f"{part} imports {name}"


def test_plant_does_not_share_the_controllers_model() -> None:
    for path in _files("sitl"):
        assert "autopilot.core.model4" not in _imports(path), path


def test_no_clock_and_no_global_randomness_in_the_libraries() -> None:
    banned = {"time.time", "time.monotonic", "time.sleep", "datetime.now", "np.random.seed", "random.random"}
    files = [ROOT / "autopilot" / f"{part}.py" for part in ("commander", "failsafes", "goals", "service", "watch")]
    for room in ("autopilot/core", "autopilot/control", "autopilot/mavlink", "estimator", "mission", "sitl"):
        files += _files(room)
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                assert ast.unparse(node.func) not in banned, f"{path}: {ast.unparse(node.func)}"


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, autopilot.cli.main\n"
        "heavy = {'numpy', 'casadi', 'cv2', 'scipy', 'matplotlib', 'bokeh', 'pymavlink', 'rich'} & set(sys.modules)\n"
        "sys.exit(','.join(sorted(heavy)) or 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
