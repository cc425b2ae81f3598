"""Every place that starts a process, and that Python processes among them import nothing from the current folder."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hostile_folder import imported_from, make_hostile

from autopilot.campaign.run_store import read_results
from tests.short_campaign import scenario_in

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("autopilot", "drivers", "estimator", "mission", "sitl", "docs")
HELPER = "autopilot/core/own_python.py"
OURS = ("python_command", "autopilot_command")

PLACES: dict[tuple[str, str], str] = {
    ("tests/bench/ardusub/rig.py", "_markers"): "ours",
    ("tests/bench/ardusub/rig.py", "_process"): "given",
    ("tests/bench/ardusub/rig.py", "upload"): "ours",
    ("tests/bench/attitude.py", "bench_attitude"): "pool",
    ("tests/bench/estimator.py", "bench_estimator"): "pool",
    ("tests/bench/gaps.py", "main"): "pool",
    ("tests/bench/speed_bound.py", "main"): "pool",
    ("autopilot/bench/live_service.py", "live_service"): "ours",
    ("tests/bench/kills.py", "_vehicle"): "ours",
    ("autopilot/bench/loop.py", "bench_loop"): "ours",
    ("tests/bench/turns.py", "_checked_out"): "ours",
    ("tests/bench/turns.py", "_git_bytes"): "git",
    ("tests/bench/turns.py", "_rows"): "ours",
    ("autopilot/bench/nmpc.py", "_process"): "ours",
    ("autopilot/campaign/engines.py", "_pool"): "pool",
    ("autopilot/campaign/engines.py", "_client"): "pool",
    ("autopilot/campaign/engines.py", "_prepare"): "pool",
    ("autopilot/run/children.py", "__init__"): "given",
    ("autopilot/run/demo.py", "_service"): "ours",
    ("autopilot/run/provenance.py", "_git"): "git",
    ("docs/browser.py", "page"): "bash",
    ("docs/hardware_pictures.py", "begin"): "ours",
    ("docs/hardware_pictures.py", "do"): "ours",
    ("docs/hardware_pictures.py", "floor"): "ours",
    ("docs/lines.py", "count"): "git",
    ("docs/page_pictures.py", "drawn"): "ours",
    ("docs/page_pictures.py", "reported"): "ours",
    ("docs/viewed_flight.py", "viewed_flight"): "ours",
    ("drivers/watchdog_process.py", "_start"): "ours",
    ("sitl/camera_process.py", "open"): "ours",
}
"""File and function -> what is started: Python by a command of ours, a library's pool of processes, another program.
What :class:`autopilot.run.children.Child` is given is looked at where it is made."""

WITHIN = {"_client": "run"}
"""What a function starts for another one, which says how."""

STARTS = frozenset(
    (
        *("subprocess.Popen", "subprocess.run", "subprocess.call", "subprocess.check_call", "subprocess.check_output"),
        *("subprocess.getoutput", "os.system", "os.popen", "os.fork", "os.forkpty", "pty.fork", "pty.spawn"),
        *("asyncio.create_subprocess_exec", "asyncio.create_subprocess_shell", "Popen", "run_path", "Child"),
        *("ProcessPoolExecutor", "cf.ProcessPoolExecutor", "forkserver.ensure_running"),
        *("self._distributed.Client", "self._distributed.LocalCluster"),
    )
)
FAMILIES = ("os.exec", "os.spawn", "os.posix_spawn", "multiprocessing.")
HARMLESS = frozenset(("multiprocessing.get_context",))
"""Starts nothing."""


def _calls(path: Path) -> list[tuple[str, str]]:
    """(function, call) of every start of a process in a file."""
    found: list[tuple[str, str]] = []

    def look(node: ast.AST, function: str) -> None:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            function = node.name
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in STARTS or (name.startswith(FAMILIES) and name not in HARMLESS):
                found.append((function, name))
        for child in ast.iter_child_nodes(node):
            look(child, function)

    look(ast.parse(path.read_text(encoding="utf-8")), "")
    return found


def _files() -> list[Path]:
    links = {link for link in (ROOT / "autopilot").iterdir() if link.is_symlink()}
    files = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    studies = [path for path in sorted((ROOT / "tests" / "bench").rglob("*.py")) if not path.stem.startswith("test_")]
    return [path for path in files if links.isdisjoint(path.parents)] + studies


def _function(path: Path, name: str) -> str:
    """Source of the functions of that name."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return "\n".join(ast.unparse(n) for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == name)


def test_every_place_that_starts_a_process_stands_here() -> None:
    found = {(str(path.relative_to(ROOT)), function) for path in _files() for function, _ in _calls(path)}
    assert found == set(PLACES)


@pytest.mark.parametrize("place", PLACES, ids=lambda place: " ".join(place))
def test_a_place_starts_what_it_says_in_the_one_way(place: tuple[str, str]) -> None:
    file, function = place
    text, whole = _function(ROOT / file, WITHIN.get(function, function)), (ROOT / file).read_text(encoding="utf-8")
    match PLACES[place]:
        case "ours":
            assert any(f"{helper}(" in text for helper in (*OURS, "_command"))
            assert any(f"{helper}(" in whole for helper in OURS)
        case "pool":
            assert "with safe_path()" in text
        case "given":
            assert "Popen(command" in text
        case program:
            assert f"'{program}'" in text


def test_the_interpreter_is_named_in_one_place() -> None:
    naming = {str(path.relative_to(ROOT)) for path in _files() if "sys.executable" in path.read_text(encoding="utf-8")}
    assert naming == {HELPER}


SCRIPT = "from autopilot.cli.main import main\nif __name__ == '__main__':\n    main()\n"
"""What the console script says: Python is started without -P, as pip writes it."""


@pytest.mark.parametrize("engine", ["local", "dask"])
def test_processes_of_a_campaign_import_nothing_from_the_current_folder(engine: str, tmp_path: Path) -> None:
    """A pool's server and workers, a cluster's nannies and workers, their trackers of resources."""
    if engine == "dask":
        pytest.importorskip("distributed")
    hostile, programs = make_hostile(tmp_path / "project"), tmp_path / "bin"
    programs.mkdir()
    (programs / "autopilot").write_text(SCRIPT, encoding="utf-8")
    scenario = scenario_in(tmp_path, seconds=0.5)
    done = subprocess.run(
        [
            *(sys.executable, str(programs / "autopilot"), "campaign", scenario, "--runs", "2"),
            *("--jobs", "2", "--engine", engine, "--out", str(tmp_path / "out"), "--no-figures", "--logs", "0"),
        ],
        cwd=hostile,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert imported_from(hostile) == []
    assert done.returncode == 1, done.stderr  # nobody finishes laps in that time
    assert len(read_results(tmp_path / "out")) == 2
