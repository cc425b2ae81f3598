"""File of a simulated vehicle's true poses, a JSON line each."""

from pathlib import Path
from typing import IO

from autopilot.core.errors import ConfigError


def opened_truth(path: Path | None) -> IO[bytes] | None:
    """The file, open to be written, None for None. ConfigError if it cannot be."""
    try:
        return None if path is None else path.open("wb")
    except OSError as error:
        raise ConfigError(f"--truth {path}: cannot be written ({error.strerror}); check folder and rights") from error
