"""An installation without a checkout: the wheel holds every file that the packages read."""

import os
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

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


@needs_setuptools
def test_a_built_wheel_holds_them(tmp_path: Path) -> None:
    """Without the compiled step, which is optional and takes ten times as long."""
    build = "import setuptools.build_meta as backend, sys; backend.build_wheel(sys.argv[1])"
    source = tmp_path / "source"
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    environment = {**os.environ, "CC": "false", "PYTHONPATH": ""}
    subprocess.run([sys.executable, "-c", build, str(tmp_path)], cwd=source, env=environment, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    assert {str(path.relative_to(ROOT)) for path in data_files()} <= held
    assert {str(path.relative_to(ROOT)) for package in packages() for path in package.rglob("*.py")} <= held
