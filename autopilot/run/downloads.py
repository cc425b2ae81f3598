"""What clients may download from a run."""

from pathlib import Path

from autopilot.core.desk import Desk
from autopilot.core.lane import DaemonLane
from autopilot.log.directory_reader import LogShelf
from autopilot.run.config import EffectiveSettings


def log_shelf(settings: EffectiveSettings, *, patient: bool) -> LogShelf:
    """The logs of a run's folder. ``patient``: in lockstep the loop waits for the disk."""
    single = None if settings["log"] is None else Path(settings["log"])
    return LogShelf(Path(settings["log_dir"]), Desk(DaemonLane("files"), patient=patient), single)
