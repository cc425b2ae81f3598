"""A user's folder with modules and packages that bear the names of ours and of what we import."""

from pathlib import Path

PACKAGES = ("autopilot", "drivers", "estimator", "mission", "sitl", "numpy", "multiprocessing")
MODULES = ("click", "logging", "msgspec", "psutil", "selectors", "socket", "subprocess", "threading")


def make_hostile(folder: Path, names: tuple[str, ...] = (*PACKAGES, *MODULES)) -> Path:
    """``folder``, made: whatever imports from it ends, and leaves the name of what it imported in ``imported.txt``."""
    folder.mkdir(parents=True)
    trap = (
        "import builtins\nwith builtins.open({report!r}, 'a') as told:\n    told.write('{name}\\n')\n"
        "raise SystemExit('the {name} of the current folder was imported')\n"
    )
    report = str(folder / "imported.txt")
    for name in names:
        text = trap.format(report=report, name=name)
        if name in PACKAGES:
            (folder / name).mkdir()
            (folder / name / "__init__.py").write_text(text, encoding="utf-8")
        else:
            (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return folder


def imported_from(folder: Path) -> list[str]:
    """What has been imported from it."""
    report = folder / "imported.txt"
    return report.read_text(encoding="utf-8").split() if report.exists() else []
