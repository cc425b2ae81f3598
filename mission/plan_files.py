"""Plan files of all formats, chosen by suffix: ``.plan``, ``.waypoints``, ``.toml``."""

from pathlib import Path

from autopilot.core.disk import write_whole
from autopilot.core.errors import PlanError
from autopilot.mission.local_plan import read_local_plan
from autopilot.mission.plan_model import PlanFile
from autopilot.mission.qgc_plan import read_qgc_plan, write_qgc_plan
from autopilot.mission.waypoints_file import read_waypoints

MAX_FILE_BYTES = 8_000_000
"""A full plan of 3 x 1000 items is about 1.5 MB of JSON."""
_READERS = {
    ".plan": read_qgc_plan,
    ".json": read_qgc_plan,
    ".waypoints": read_waypoints,
    ".txt": read_waypoints,
    ".toml": read_local_plan,
}

__all__ = ["PlanFile", "read_plan", "write_plan"]


def read_plan(path: Path) -> PlanFile:
    """Read a plan file.

    Parameters
    ----------
    path
        ``.plan`` or ``.json`` (QGroundControl), ``.waypoints`` or ``.txt`` (QGC WPL 110), ``.toml`` (local metres).

    Returns
    -------
    PlanFile
        Items in wire units (degrees times 1e7 or local metres times 1e4).

    Raises
    ------
    PlanError
        It cannot be read; one line with file, place and remedy.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise PlanError(f"{path}: unknown kind of plan file; use .plan (QGroundControl), .waypoints or .toml")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise PlanError(f"{path}: is larger than {MAX_FILE_BYTES} bytes, which no plan is; give a plan file")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise PlanError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise PlanError(f"{path}: is not UTF-8 text; export the plan again") from error
    return reader(text, str(path))


def write_plan(path: Path, plan: PlanFile) -> None:
    """Write a ``.plan`` file for QGroundControl.

    Parameters
    ----------
    path
        Its name, ending in ``.plan``; an existing file is replaced.
    plan
        Its content.

    Raises
    ------
    PlanError
        It cannot be written, or the name ends otherwise.
    """
    if path.suffix.lower() != ".plan":
        raise PlanError(f"{path}: plans are written as .plan only; give a name that ends so")
    text = write_qgc_plan(plan)
    try:
        write_whole(path, text)
    except OSError as error:
        raise PlanError(f"{path}: cannot be written ({error.strerror}); check folder and rights") from error
