"""What the service needs on a small ARM computer can be had there without a compiler."""

import tomllib
from pathlib import Path


def test_all_that_hardware_needs_has_wheels_for_a_raspberry_pi() -> None:
    """Names of pyproject.toml against the list that was looked through, with the platforms of their wheels."""
    root = Path(__file__).resolve().parents[2]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["hardware"]]
    names = {text.split(">")[0].split("=")[0].split("[")[0].strip() for text in needed}
    lines = (root / "tests" / "run" / "aarch64_wheels.txt").read_text(encoding="utf-8").splitlines()
    rows = [line.split() for line in lines if line and not line.startswith("#")]
    assert {row[0] for row in rows} == names
    assert all("aarch64" in row[2] or row[2] == "any" for row in rows)
