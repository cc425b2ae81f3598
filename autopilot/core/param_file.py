"""Parameters on disk. Written whole and renamed, so that a power cut leaves the old file or the new one.

Reads QGroundControl's five tab-separated columns (vehicle, component, name, value, type) and ``NAME value`` or
``NAME,value`` (ArduPilot, MAVProxy); writes QGroundControl's form. A file that somebody gives is read strictly: what is
wrong in it is an error. The file that a vehicle keeps must not keep it from starting: lines that cannot be used are
warnings, the parameter has its default then, and names that this version does not know stay in the file.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from autopilot.core.desk import Desk
from autopilot.core.disk import cause_of
from autopilot.core.errors import ConfigError
from autopilot.core.keeper import Keeper
from autopilot.core.params import ParamSet, ParamType, Saved
from autopilot.core.state_file import StateFile

MAV_PARAM_TYPE = {ParamType.INT32: 6, ParamType.REAL32: 9}
"""MAV_PARAM_TYPE (common.xml)."""

_HEAD = "# Vehicle-Id Component-Id Name Value Type"
_QGC_COLUMNS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class ParamText:
    """What a parameter file holds, line by line."""

    values: dict[str, float]
    unknown: dict[str, str]
    """Lines with names that do not exist, by "file:line: name"."""
    errors: tuple[str, ...]
    """What is wrong with lines that cannot be used, each with file and line."""


def scan_params(text: str, origin: str) -> ParamText:
    """Read every line of a parameter file; ``origin`` names it in messages."""
    trial = ParamSet()
    values: dict[str, float] = {}
    unknown: dict[str, str] = {}
    errors: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        place = f"{origin}:{number}"
        try:
            found = _read_line(line)
            if found is not None and found[0] not in trial:
                unknown[f"{place}: parameter {found[0]} does not exist"] = line
            elif found is not None:
                trial.set(*found)
                values[found[0]] = found[1]
        except ConfigError as error:
            errors.append(f"{place}: {error}")
    return ParamText(values=values, unknown=unknown, errors=tuple(errors))


def _read_line(line: str) -> tuple[str, float] | None:
    """Name and value, None for a line without. ConfigError if it is something else."""
    text = line.split("#", 1)[0].strip()
    if not text:
        return None
    columns = text.split("\t")
    if len(columns) == _QGC_COLUMNS:
        name, raw = columns[2], columns[3]
    else:
        fields = re.split(r"[,\s]+", text)
        if len(fields) != 2:
            raise ConfigError(f"{text!r} is not 'NAME value'; correct or remove the line")
        name, raw = fields
    try:
        return name, float(raw)
    except ValueError as error:
        raise ConfigError(f"{name} = {raw!r} is not a number; correct it") from error


def scan_param_file(path: Path) -> ParamText:
    """Read a file that somebody gives. ConfigError when it cannot be read at all."""
    try:
        return scan_params(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text; export the parameters again") from error


def param_text(values: Mapping[str, float], *, sysid: int = 1, more: tuple[str, ...] = ()) -> str:
    """A file in QGroundControl's form; ``more``: lines that go in as they are."""
    table = ParamSet()
    lines = [_HEAD]
    for name in sorted(values):
        kind = table.spec(name).type
        value = f"{int(values[name])}" if kind is ParamType.INT32 else f"{values[name]:.9g}"
        lines.append(f"{sysid}\t1\t{name}\t{value}\t{MAV_PARAM_TYPE[kind]}")
    return "\n".join((*lines, *more)) + "\n"


def write_param_file(path: Path, values: Mapping[str, float], *, sysid: int = 1) -> None:
    """Write ``values`` atomically in QGroundControl's form. ConfigError if the file cannot be written."""
    try:
        StateFile(path, copies=False).write(param_text(values, sysid=sysid).encode())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); check folder and rights") from error


def kept_params(
    folder: Path, params: ParamSet, overrides: Mapping[str, float], desk: Desk | None
) -> tuple["PersistentParams", tuple[str, ...]]:
    """``params``, which have the defaults of vehicle and place, with what earlier runs have kept in ``folder`` and the
    ``overrides`` of the command line; the result is where they are kept from now on and what is wrong with the file.

    Without the ``desk`` of the disk they are only looked at: nothing is cleaned up, nothing set aside.
    """
    persistent = PersistentParams(folder / "parameters.params", params, desk)
    warnings = persistent.load(mend=desk is not None)
    for name, value in overrides.items():
        params.set(name, value)
    return persistent, warnings


class PersistentParams:
    """Keeps on disk what operators set at run time, and nothing else (not defaults, not command-line values).

    The writing goes over a desk; :meth:`save` and :meth:`saved` are what the parameter protocol asks.
    """

    def __init__(self, path: Path, params: ParamSet, desk: Desk | None = None) -> None:
        """``desk``: the lane of the disk, by default the caller's own time."""
        self._file = StateFile(path)
        self._params = params
        self._wanted: dict[str, float] = {}
        self._unknown: tuple[str, ...] = ()
        self._keeper: Keeper[bytes] = Keeper(desk or Desk(), self._file.write)
        self._number = 0
        self.failure: str | None = None
        """Why the last change is not on disk; None while all is well."""

    def load(self, *, mend: bool = True) -> tuple[str, ...]:
        """Apply the file, if there is one. The result is what an operator should know: lines that were left out.

        ``mend``: remove what a killed service left, set a file aside that cannot be used.
        """
        problems: list[str] = []
        try:
            if mend:
                self._file.clean()
            found, problems = self._file.read(self._parse, set_aside=mend)
        except OSError as error:
            return (f"{self._file.path}: cannot be read ({error.strerror}); parameters have their defaults",)
        if found is None:
            return tuple(problems)
        self._wanted = dict(found.values)
        self._unknown = tuple(found.unknown.values())
        for name, value in found.values.items():
            self._params.set(name, value)
        left_out = (f"{place}; the line is kept and not used" for place in found.unknown)
        return (*problems, *(f"{error}; its default is used" for error in found.errors), *left_out)

    def save(self, tick: int, name: str) -> int | None:
        """Have the value in force of a parameter kept. A number to wait for; None when that is on disk already."""
        value = self._params[name]
        if self._wanted.get(name) != value:
            self._wanted[name] = value
        elif not self._keeper.busy and self.failure is None:
            return None
        text = param_text(self._wanted, more=self._unknown)
        self._number = self._keeper.put(tick, text.encode())
        return self._number

    def saved(self, tick: int) -> Saved | None:
        """What became of a write, once."""
        kept = self._keeper.poll(tick)
        if kept is None:
            return None
        error = kept.error
        self.failure = None if error is None else f"parameters are not saved: {self._file.path}: {error}"
        cause = "" if error is None else cause_of(error)
        return Saved(number=kept.number, failure=cause)

    def finish(self) -> None:
        """Write what is not yet on disk."""
        error = self._keeper.finish()
        self.failure = None if error is None else f"parameters are not saved: {self._file.path}: {error}"

    def _parse(self, data: bytes) -> ParamText:
        if not data.strip():
            raise ValueError("is empty")
        try:
            return scan_params(data.decode("utf-8"), str(self._file.path))
        except UnicodeDecodeError as error:
            raise ValueError("is not UTF-8 text") from error
