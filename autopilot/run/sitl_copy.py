"""A commented copy of a scenario to edit, with the files that it needs (``autopilot scenario new``)."""

import re
from importlib import resources
from pathlib import Path

from autopilot.core.disk import write_whole
from autopilot.core.errors import ConfigError
from autopilot.sitl.scenario import FILE_KEYS, load_scenario, load_tables, plan_path, scenario_path

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
DRAWN = 'fence = "from tank and obstacles" # the plan\'s fence follows what stands below'


def copy_scenario(name: str, source: str, target: Path) -> list[Path]:
    """Write a copy as ``target`` and the files that it needs beside it; returns the files. ConfigError: invalid
    name, unknown or invalid source, or a file exists already.
    """
    folder = target.parent
    if _NAME.fullmatch(name) is None or name.endswith(".toml"):
        raise ConfigError(f"{name!r} is no name for a scenario; use letters, digits and dashes")
    scenario = load_scenario(source)
    text = scenario_path(source).read_text(encoding="utf-8-sig")
    copies: dict[Path, bytes] = {}
    plan, plan_name = plan_path(source, scenario), None
    if plan is not None:
        plan_name = name + "".join(plan.suffixes[-2:] if plan.name.endswith(".mission.toml") else plan.suffixes[-1:])
        copies[folder / plan_name] = plan.read_bytes()
    tables = load_tables(source)
    for table, key in (*FILE_KEYS, ("vehicle", "model")):
        value = tables.get(table, {}).get(key)
        if isinstance(value, str) and Path(value).is_absolute() and Path(value).is_file():
            copies[folder / Path(value).name] = Path(value).read_bytes()
    drawn = plan is not None and scenario.scenario.fence is None and (scenario.tank is not None or scenario.obstacle)
    edited = _edited(text, name, plan_name, drawn=bool(drawn))
    more = (resources.files("autopilot") / "data" / "templates" / "scenario-more.toml").read_text(encoding="utf-8")
    copies[target] = f"{edited.rstrip()}\n\n{more}".encode()
    write_copies(copies, folder)
    return list(copies)


def check_file_name(name: str) -> None:
    """ConfigError unless NAME.toml is a file of that folder and NAME a text in TOML."""
    if not name or any(mark in name for mark in '"\\/\n') or name.endswith(".toml"):
        raise ConfigError(f"{name!r} is no name of a file; use letters, digits and dashes, without .toml")


def copy_target(name: str, out: Path | None) -> Path:
    """File of a copy: ``out``, or NAME.toml in it if that is a folder, or here."""
    if out is not None and out.suffix == ".toml" and not out.is_dir():
        return out
    return (out or Path()) / f"{name}.toml"


def write_copies(copies: dict[Path, bytes], folder: Path) -> None:
    """Write the files into the folder. ConfigError, and nothing is written, where one of them exists."""
    there = next((path for path in copies if path.exists()), None)
    if there is not None:
        raise ConfigError(f"{there}: is there already; choose another name or --out")
    try:
        for path, data in copies.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, data)
    except OSError as error:
        for path in copies:  # those before the one that failed
            path.unlink(missing_ok=True)
        raise ConfigError(f"{folder}: cannot be written ({error.strerror}); choose another --out") from error


def _edited(text: str, name: str, plan: str | None, *, drawn: bool) -> str:
    """The file with other values in ``[scenario]``; comments stay."""
    lines: list[str] = []
    table = ""
    for line in text.splitlines():
        if line.startswith("["):
            table = line.split("]")[0].strip("[")
        if table == "scenario" and re.match(r"name\s*=", line):
            line = f'name = "{name}"'
        if table == "scenario" and plan is not None and re.match(r"plan\s*=", line):
            lines.append(f'plan = "{plan}"')
            line = DRAWN if drawn else ""
            if not drawn:
                continue
        lines.append(line)
    return "\n".join(lines)
