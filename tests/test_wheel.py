"""An installation without a checkout: the wheel holds every file that the packages read."""

import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest
from hostile_folder import imported_from, make_hostile
from pwm_vehicle import PwmVehicle, gone, keepers_of, until

from autopilot.cli.console_output import EXIT_LOSS
from autopilot.core.extras import ANALYSIS

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
MADE = {".pyc", ".so", ".pyd"}
"""Endings of what a machine makes beside the sources."""


def packages() -> list[Path]:
    """Top folders of what is installed."""
    names = PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
    return [ROOT / name.rstrip("*") for name in names]


def data_files() -> set[Path]:
    """What lies in the packages and is no module."""
    return {
        path
        for package in packages()
        for path in package.rglob("*")
        if path.is_file() and path.suffix not in {".py", *MADE} and "__pycache__" not in path.parts
    }


def test_every_data_file_is_declared() -> None:
    declared = PROJECT["tool"]["setuptools"]["package-data"]
    covered = {
        path for package, globs in declared.items() for pattern in globs for path in (ROOT / package).glob(pattern)
    }
    assert {str(path.relative_to(ROOT)) for path in data_files() - covered} == set()


def test_modules_without_a_package_file_are_found() -> None:
    """setuptools' `find` leaves out folders without ``__init__.py``."""
    for package in packages():
        for module in package.rglob("*.py"):
            assert (module.parent / "__init__.py").exists(), module.relative_to(ROOT)


needs_setuptools = pytest.mark.skipif(
    int(version("setuptools").split(".")[0]) < 77, reason="wheels are built by setuptools 77 or newer"
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built of the files of the repository, as `pip wheel` does it; compiled where there is a compiler."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    for name in filter(None, listed.stdout.split("\0")):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_symlink():
            (source / name).symlink_to((ROOT / name).readlink())
        elif (ROOT / name).is_file():
            (source / name).write_bytes((ROOT / name).read_bytes())
    build = "import setuptools.build_meta as backend, sys; backend.build_wheel(sys.argv[1])"
    command = [sys.executable, "-c", build, str(folder)]
    subprocess.run(command, cwd=source, env={**os.environ, "PYTHONPATH": ""}, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


@needs_setuptools
def test_a_built_wheel_holds_every_module_and_data_file(wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    modules = {path for package in packages() for path in package.rglob("*.py")}
    assert {str(path.relative_to(ROOT)) for path in data_files() | modules} <= held
    assert "-py3-none-" in wheel.name, "the library uses nothing of Python"
    assert "autopilot/core/_compiled.so" in held
    assert {"autopilot/py.typed", "autopilot/sitl/scenarios/paper-tank.toml", "autopilot/drivers/watchdog.py"} <= held


@needs_setuptools
def test_a_built_wheel_puts_one_package_among_those_of_others(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name and ".data/" not in name} == {"autopilot"}
    beside = {name.split(".data/")[1] for name in names if ".data/" in name}
    assert {path.rsplit("/", 1)[0] for path in beside} == {
        "data/share/underwater-autopilot",
        "data/share/underwater-autopilot/examples",
    }
    examples = {path.rsplit("/", 1)[1] for path in beside if "/examples/" in path}
    assert examples == {path.name for path in (ROOT / "docs" / "examples").iterdir() if path.is_file()}


class Installed:
    """The wheel in an environment of its own, beside a user's folder. Dependencies are those of the tests."""

    def __init__(self, wheel: Path, folder: Path) -> None:
        self.folder = folder
        venv.create(folder / "venv", with_pip=False)
        self.programs = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
        self.python = self.programs / "python"
        site = Path(self._of("import sysconfig; print(sysconfig.get_path('purelib'))", folder).strip())
        (site / "dependencies.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(self.python)]
        install = [*pip, "install", "--quiet", "--no-deps", "--no-index", "--ignore-installed", str(wheel)]
        subprocess.run(install, check=True)
        found = self._of("import autopilot; print(autopilot.__file__)", folder)
        assert Path(found.strip()) == site / "autopilot" / "__init__.py"
        self.site = site

    @property
    def environment(self) -> dict[str, str]:
        """Without the checkout."""
        return {**os.environ, "PYTHONPATH": "", "AUTOPILOT_STATE_DIR": str(self.folder / "state")}

    def _of(self, code: str, cwd: Path) -> str:
        done = subprocess.run(
            [self.python, "-c", code], cwd=cwd, env=self.environment, capture_output=True, text=True, check=True
        )
        return done.stdout

    def run(self, *command: str | Path, cwd: Path, **environment: str) -> "subprocess.CompletedProcess[str]":
        env = {**self.environment, **environment}
        return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False, timeout=1200)


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    pytest.importorskip("pip")
    return Installed(wheel, tmp_path_factory.mktemp("installed"))


@needs_setuptools
def test_an_installation_adds_one_package(installed: Installed) -> None:
    added = {path.name for path in installed.site.iterdir()} - {"dependencies.pth"}
    assert {name for name in added if not name.endswith(".dist-info")} == {"autopilot"}


@needs_setuptools
def test_an_installation_has_benchmarks_and_says_where_the_studies_are(installed: Installed, tmp_path: Path) -> None:
    shown = installed.run(installed.programs / "autopilot", "bench", "--help", cwd=tmp_path)
    listed = shown.stdout.partition("Commands:\n")[2].partition("\n\n")[0]
    commands = [line.split()[0] for line in listed.splitlines() if line[2:3].strip()]
    assert commands == ["estimator", "loop", "nmpc", "sitl"]
    done = installed.run(installed.programs / "autopilot", "bench", "soak", cwd=tmp_path)
    assert done.returncode == 2
    assert "soak is a study: run it in a source checkout of this project" in done.stderr


WITHOUT_ANALYSIS = """
import sys
sys.modules.update(dict.fromkeys({names}))
"""


@needs_setuptools
def test_the_service_runs_without_what_only_analysis_needs(installed: Installed, tmp_path: Path) -> None:
    """And whoever asks for analysis is told in one sentence what to install, before any work."""
    names = [re.split("[<>=]", asked)[0] for asked in PROJECT["project"]["optional-dependencies"]["analysis"]]
    assert set(ANALYSIS) < set(names)
    (tmp_path / "sitecustomize.py").write_text(WITHOUT_ANALYSIS.format(names=names), encoding="utf-8")

    def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
        return installed.run(installed.programs / "autopilot", *arguments, cwd=tmp_path, PYTHONPATH=str(tmp_path))

    sitl = ("sitl", "--sensors", "pose", "--speed", "0", "--connect", "udpout:127.0.0.1:9", "--log", "run.mcap")
    for works in ((*sitl, "--duration", "0.05"), ("log", "check", "run.mcap"), ("log", "export", "run.mcap")):
        done = run(*works)
        assert done.returncode in (0, EXIT_LOSS) and "error" not in done.stderr, (works, done.stderr)
    for needs in (
        ("log", "report", "run.mcap"),
        ("log", "plot", "run.mcap"),
        ("log", "replay", "run.mcap", "--step", "0.01"),
        ("campaign", "paper-tank", "--runs", "1", "--out", "campaign"),
        ("campaign", "rooms", "--runs", "1", "--only", "0", "--out", "rooms"),
        ("calibrate", "camera", ".", "--plot", "plot.png"),
        ("demo", "--out", "demo"),
    ):
        done = run(*needs)
        assert done.returncode == 1, (needs, done.stderr)
        said = r"error: this needs \w+, .* pip install 'underwater-autopilot\[analysis\]'.*\n"
        assert re.fullmatch(said, done.stderr), (needs, done.stderr)
    assert not {path.name for path in tmp_path.iterdir()} & {"campaign", "rooms", "demo", "plot.png"}


OURS = ("drivers", "estimator", "mission", "sitl")
FLIGHT = """
import mission  # the user's
import autopilot
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_session import open_sitl

settings = gather(sitl_defaults(0), {"speed": 0.0, "sensors": "pose"}, {})
settings.put("connect", (), "here")
settings.put("log", None, "here")
ticks = []
session = open_sitl(settings, {}, log=False, on_tick=ticks.append)
for tick in range(1, 21):
    session.runtime.tick(10_000 * tick)
session.runtime.close()
print(mission.MINE, len(ticks), ticks[-1].nav is not None, autopilot.__file__)
"""


@needs_setuptools
def test_a_users_script_beside_a_mission_of_his_own_flies(installed: Installed, tmp_path: Path) -> None:
    hostile = make_hostile(tmp_path / "project", tuple(name for name in OURS if name != "mission"))
    (hostile / "mission.py").write_text("MINE = 42\n", encoding="utf-8")
    (hostile / "fly.py").write_text(FLIGHT, encoding="utf-8")
    done = installed.run(installed.python, "fly.py", cwd=hostile)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["42", "20", "True", str(installed.site / "autopilot" / "__init__.py")]
    assert imported_from(hostile) == []


@needs_setuptools
def test_the_commands_of_an_installation_work_in_a_users_folder(installed: Installed, tmp_path: Path) -> None:
    check = ("mission", "check", str(installed.site / "autopilot" / "sitl" / "scenarios" / "paper.plan"))
    sitl = ("sitl", "--sensors", "pose", "--speed", "0", "--duration", "0.05", "--connect", "udpout:127.0.0.1:9")
    hostile = make_hostile(tmp_path / "project")
    for arguments in (check, (*sitl, "--log", str(tmp_path / "run.mcap"))):
        done = installed.run(installed.programs / "autopilot", *arguments, cwd=hostile)
        assert done.returncode == 0, done.stderr
    # -m looks for the package itself, and for what Python needs to begin, in the current folder: that is what -m means.
    for_m = make_hostile(tmp_path / "another", (*OURS, "numpy", "click", "msgspec"))
    done = installed.run(installed.python, "-m", "autopilot", *check, cwd=for_m)
    assert done.returncode == 0, done.stderr
    assert imported_from(hostile) == imported_from(for_m) == []


@needs_setuptools
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
def test_the_keeper_of_an_installation_stops_the_thrusters_of_a_killed_service(
    installed: Installed, tmp_path: Path
) -> None:
    hostile = make_hostile(tmp_path / "project")
    with PwmVehicle(tmp_path / "vehicle") as vehicle:
        command = [installed.programs / "autopilot", "run", "--config", str(vehicle.config)]
        service = subprocess.Popen(command, cwd=hostile, env=installed.environment, stdout=subprocess.DEVNULL)
        try:
            vehicle.fly()
            (watchdog,) = keepers_of(service.pid)
        finally:
            service.kill()
            service.wait()
        until(lambda: vehicle.still and gone(watchdog))
    assert imported_from(hostile) == []
