"""Parameters on disk. Written whole and renamed, so that a power cut leaves the old file or the new one.

Reads QGroundControl's five tab-separated columns (vehicle, component, name, value, type) and ``NAME value`` or
``NAME,value`` (ArduPilot, MAVProxy); writes QGroundControl's form.
"""

import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

from autopilot.core.errors import ConfigError
from autopilot.core.params import ParamSet, ParamType

MAV_PARAM_TYPE = {ParamType.INT32: 6, ParamType.REAL32: 9}
"""MAV_PARAM_TYPE (common.xml)."""

_QGC_COLUMNS = 5


def read_param_file(path: Path) -> dict[str, float]:
    """Name -> value. Every line is checked against the table; ConfigError names the first bad line, nothing is used."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text; export the parameters again") from error
    trial = ParamSet()
    values: dict[str, float] = {}
    for number, line in enumerate(lines, start=1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        columns = text.split("\t")
        if len(columns) == _QGC_COLUMNS:
            name, raw = columns[2], columns[3]
        else:
            fields = re.split(r"[,\s]+", text)
            if len(fields) != 2:
                raise ConfigError(f"{path}:{number}: {text!r} is not 'NAME value'; correct or remove the line")
            name, raw = fields
        try:
            value = float(raw)
        except ValueError as error:
            raise ConfigError(f"{path}:{number}: {name} = {raw!r} is not a number; correct it") from error
        try:
            trial.set(name, value)
        except ConfigError as error:
            raise ConfigError(f"{path}:{number}: {error}") from error
        values[name] = value
    return values


def write_param_file(path: Path, values: Mapping[str, float], *, sysid: int = 1) -> None:
    """Write ``values`` atomically in QGroundControl's form. ConfigError if the file cannot be written."""
    table = ParamSet()
    lines = ["# Vehicle-Id Component-Id Name Value Type"]
    for name in sorted(values):
        kind = table.spec(name).type
        value = f"{int(values[name])}" if kind is ParamType.INT32 else f"{values[name]:.9g}"
        lines.append(f"{sysid}\t1\t{name}\t{value}\t{MAV_PARAM_TYPE[kind]}")
    try:
        _replace(path, "\n".join(lines) + "\n")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); check folder and rights") from error


def _replace(path: Path, text: str) -> None:
    """The file is the old one or the new one, never half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError:
        Path(temporary).unlink(missing_ok=True)
        raise


class PersistentParams:
    """Keeps on disk what was changed at run time, and nothing else (not defaults, not command-line values)."""

    def __init__(self, path: Path, params: ParamSet) -> None:
        self._path = path
        self._params = params
        self._saved: dict[str, float] = {}
        self._seen: dict[str, float] = {}
        self._revision = -1
        self.failure: str | None = None
        """Why the last change is not on disk; None while all is well."""

    def load(self) -> None:
        """Apply the file if there is one. ConfigError leaves all parameters as they were."""
        if self._path.exists():
            self._saved = read_param_file(self._path)
            for name, value in self._saved.items():
                self._params.set(name, value)

    def mark(self) -> None:
        """From here on a change counts as made at run time."""
        self._seen = dict(self._params)
        self._revision = self._params.revision

    def save_changes(self) -> None:
        """Write the file if a parameter changed since the last call; cheap when none did. Never raises: a vehicle
        under way does not stop for a full disk (``failure`` says why, the next change tries again)."""
        if self._params.revision == self._revision:
            return
        changed = {name: value for name, value in self._params.items() if self._seen.get(name) != value}
        self._saved.update(changed)
        try:
            write_param_file(self._path, self._saved)
            self.failure = None
        except ConfigError as error:
            self.failure = str(error)
        self.mark()
