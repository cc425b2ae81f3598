"""The arrows between the rooms: data flows one way, and only the composition root sees everything."""

import ast
import importlib.util
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

_spec = importlib.util.spec_from_file_location("rooms", ROOT / "docs" / "rooms.py")
assert _spec is not None and _spec.loader is not None
rooms = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(rooms)

NAMES = "autopilot"
CONTROL = tuple(f"control.{part}" for part in ("constraints", "current", "energy", "nmpc", "path", "robust", "thrust"))
ALLOWED: dict[str, tuple[str, ...]] = {
    "core": (),
    "client": ("core",),
    "mavlink": ("core",),
    "log": ("core",),
    "view": ("core", "log"),
    "drivers": ("core",),
    "estimator": ("core",),
    "mission": ("core",),
    "sitl": ("core", "drivers"),
    "control.nmpc": ("core",),
    "control.constraints": ("core",),
    "control.current": ("core",),
    "control.thrust": ("core",),
    "control.path": ("core", "control.nmpc", "control.constraints", "control.current"),
    "control.robust": ("core", "control.nmpc", "control.path"),
    "control.energy": ("core", "control.nmpc", "control.constraints", "control.current", "control.path"),
    "control": ("core", *CONTROL),
    "command": ("core", "control", *CONTROL, "mavlink", "mission", "estimator"),
    "record": ("core", "estimator", "log"),
    "replay": ("core", "control.current", "command", "estimator", "log", "mavlink", "record", "run", "sitl"),
    "calibrate": ("core", "log", "record"),
    "identify": ("core", "control.thrust", "log", "record"),
    "markermaps": ("core", "estimator", "log"),
    "run": (
        *(NAMES, "core", "client", "mavlink", "log", "drivers", "estimator", "mission", "sitl", "control", *CONTROL),
        *("command", "record", "view"),
    ),
}
"""Room (without ``autopilot.``) -> rooms that it may import from; ``command`` has the estimator's protocol only."""

LIBRARIES = ("core", "control", "command", "mavlink", "log", "run", "drivers", "estimator", "mission", "sitl")

COMPOSITION = ("cli", "bench", "analysis", "campaign", "api", NAMES)
"""May import everything below them, and each other where the order here is kept."""


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


@cache
def _arrows() -> dict[str, set[str]]:
    def short(room: str) -> str:
        return room.removeprefix("autopilot.")

    return {short(room): {short(name) for name in names} for room, names in rooms.arrows().items()}


def test_every_module_lives_in_a_room_that_stands_here() -> None:
    assert set(_arrows()) == {*ALLOWED, *COMPOSITION}
    loose = {path.name for path in (ROOT / "autopilot").glob("*.py")}
    assert loose == {"__init__.py", "__main__.py"}


@pytest.mark.parametrize("room", ALLOWED)
def test_room_imports_only_what_it_may(room: str) -> None:
    assert _arrows()[room] <= set(ALLOWED[room])


def test_what_is_installed_imports_no_study() -> None:
    """Benchmarks are imported by their commands only, and nothing but the studies' own files knows tests/."""
    for path in (file for room in (NAMES, "drivers", "estimator", "mission", "sitl") for file in _files(room)):
        names = _imports(path)
        assert not {name for name in names if name.split(".")[0] == "tests"}, path
        if path.parent.name != "bench" and not path.stem.startswith("bench"):
            assert not {name for name in names if name.startswith("autopilot.bench")}, path


def test_no_circle_of_rooms() -> None:
    found = rooms.arrows()
    found["autopilot"] = set()  # __main__ is the command line; the package itself imports nothing
    assert rooms.circles(found) == []


def test_no_circle_of_files_in_the_libraries() -> None:
    known = rooms.modules()
    files = {name: rooms.imports_of(path, known) - {name} for name, path in known.items()}
    libraries = tuple(f"{NAMES}.{room}." for room in LIBRARIES)
    found = rooms.circles(files)
    assert not [group for group in found if group[0].startswith(libraries)]


def test_deciding_knows_the_estimators_protocol_only() -> None:
    for path in _files("autopilot/command"):
        estimators = {name for name in _imports(path) if name.startswith("autopilot.estimator")}
        assert estimators <= {"autopilot.estimator.protocol"}, path


def _reached(start: str) -> set[str]:
    """Modules of ours that importing ``start`` loads."""
    known = rooms.modules()
    found, left = {start}, [start]
    while left:
        new = rooms.imports_of(known[left[-1]], known) - found
        left.pop()
        found |= new
        left += new
    return found


def test_what_hardware_shares_knows_no_simulation() -> None:
    """Of the composition only ``sitl_*`` and the demo know the simulator: a vehicle of real drivers needs the rest."""
    for path in _files("autopilot/run"):
        if path.stem.startswith("sitl_") or path.stem == "demo":
            continue
        reached = _reached(f"autopilot.run.{path.stem}" if path.stem != "__init__" else "autopilot.run")
        assert not {name for name in reached if name.startswith("autopilot.sitl")}, path


def test_the_drawing_is_of_today() -> None:
    assert rooms.PAGE.read_text(encoding="utf-8") == rooms.page_with(rooms.drawing()), "python docs/rooms.py --write"


def test_plant_does_not_share_the_controllers_model() -> None:
    for path in _files("sitl"):
        assert "autopilot.core.model4" not in _imports(path), path


def test_no_clock_and_no_global_randomness_in_the_libraries() -> None:
    banned = {"time.time", "time.monotonic", "time.sleep", "datetime.now", "np.random.seed", "random.random"}
    libraries = (
        "autopilot/core",
        "autopilot/control",
        "autopilot/command",
        "autopilot/mavlink",
        "estimator",
        "mission",
        "sitl",
    )
    for path in (path for room in libraries for path in _files(room)):
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
