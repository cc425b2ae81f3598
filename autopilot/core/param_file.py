"""Parameter files. Written completely and renamed, so that a power cut leaves the old file or the new one.

Reads QGroundControl's five tab-separated columns (vehicle, component, name, value, type) and ``NAME value`` or
``NAME,value`` (ArduPilot, MAVProxy); writes QGroundControl's format. A file given by the user is read strictly: every
problem is an error. The vehicle's own file must not prevent its start: invalid lines are warnings and the parameter
has its default; names that this version does not know are kept in the file.
"""

import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from autopilot.core.background import BackgroundWorker
from autopilot.core.disk import cause_of, write_result
from autopilot.core.errors import ConfigError
from autopilot.core.latest_value_writer import LatestValueWriter
from autopilot.core.params import ParamSet, ParamType, Saved
from autopilot.core.state_file import Loss, StateFile

MAV_PARAM_TYPE = {ParamType.INT32: 6, ParamType.REAL32: 9}
"""MAV_PARAM_TYPE (common.xml)."""

_HEAD = "# Vehicle-Id Component-Id Name Value Type"
_QGC_COLUMNS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class ParamText:
    """Content of a parameter file, line by line."""

    values: dict[str, float]
    unknown: dict[str, str]
    """Lines with names that do not exist, by "file:line: name"."""
    errors: tuple[str, ...]
    """What is wrong with lines that cannot be used, each with file and line."""
    unusable: tuple[str, ...] = ()
    """Those lines."""
    repeated: tuple[str, ...] = ()
    """Parameters that a later line gives another value, which is used, each with file and line."""


def scan_params(text: str, origin: str) -> ParamText:
    """Read every line of a parameter file; ``origin`` names it in messages."""
    trial = ParamSet()
    values: dict[str, float] = {}
    unknown: dict[str, str] = {}
    errors: list[str] = []
    unusable: list[str] = []
    repeated: list[str] = []
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), start=1):  # editors on Windows
        place = f"{origin}:{number}"
        try:
            found = _read_line(line)
            if found is not None and found[0] not in trial:
                unknown[f"{place}: parameter {found[0]} does not exist"] = line
            elif found is not None:
                name, value = found
                trial.set(name, value)
                if values.get(name, value) != value:
                    repeated.append(f"{place}: {name} = {value:g} after {name} = {values[name]:g}")
                values[name] = value
        except ConfigError as error:
            errors.append(f"{place}: {error}")
            unusable.append(line)
    return ParamText(
        values=values, unknown=unknown, errors=tuple(errors), unusable=tuple(unusable), repeated=tuple(repeated)
    )


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
    """Read a user's file. ConfigError if it cannot be read at all."""
    try:
        return scan_params(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text; export the parameters again") from error


def param_text(values: Mapping[str, float], *, more: tuple[str, ...] = ()) -> str:
    """A file in QGroundControl's form; ``more``: lines that go in as they are."""
    table = ParamSet()
    lines = [_HEAD]
    for name in sorted(values):
        kind = table.spec(name).type
        value = f"{int(values[name])}" if kind is ParamType.INT32 else f"{values[name]:.9g}"
        lines.append(f"1\t1\t{name}\t{value}\t{MAV_PARAM_TYPE[kind]}")
    return "\n".join((*lines, *more)) + "\n"


def write_param_file(path: Path, values: Mapping[str, float]) -> None:
    """Write ``values`` atomically in QGroundControl's form. ConfigError if the file cannot be written."""
    write_result(path, param_text(values), folder=True)


def kept_params(
    folder: Path, params: ParamSet, overrides: Mapping[str, float], worker: BackgroundWorker | None
) -> tuple["PersistentParams", tuple[str, ...]]:
    """``params``, which have the defaults of vehicle and site, with the values stored in ``folder`` and the
    ``overrides`` of the command line. Returns their storage and the problems of the file.

    Without the ``desk`` of the disk the folder is read only: nothing is cleaned up or set aside.
    """
    persistent = PersistentParams(folder / "parameters.params", params, worker)
    warnings = persistent.load(mend=worker is not None)
    for name, value in overrides.items():
        params.set(name, value)
    return persistent, warnings


class PersistentParams:
    """Stores values that operators set at run time, and nothing else (no defaults, no command-line values).

    Writes run on a background worker; :meth:`save` and :meth:`saved` are the interface of the parameter protocol.
    """

    def __init__(self, path: Path, params: ParamSet, worker: BackgroundWorker | None = None) -> None:
        """``desk``: worker of the disk, by default synchronous."""
        self._file = StateFile(path)
        self._params = params
        self._wanted: dict[str, float] = {}
        self._unknown: tuple[str, ...] = ()
        self._unusable: tuple[str, ...] = ()
        """Lines that stay in the file until an operator accepts that they are not used."""
        self._worker = worker or BackgroundWorker()
        self._watchdog: LatestValueWriter[bytes] = LatestValueWriter(self._worker, self._file.write)
        self._number = 0
        self.failure: str | None = None
        """Why the last change is not on disk; None while all is well."""
        self.unsaved = ""
        """The same for the operator, "" while all is well."""
        self.losses: tuple[Loss, ...] = ()
        """What :meth:`load` has not found again."""

    def load(self, *, mend: bool = True) -> tuple[str, ...]:
        """Apply the file, if there is one. Returns notices to the operator: lines that were skipped.

        ``mend``: remove temporary files of a killed service, set an unusable file aside.
        """
        if mend:
            self._file.clean()
        found, problems = self._file.read(self._parse, set_aside=mend)
        self.losses = self._loss_notices(found, problems)
        if found is None:
            return tuple(problems)
        self._wanted = {name: value for name, value in found.values.items() if self._params.spec(name).kept}
        self._unknown, self._unusable = tuple(found.unknown.values()), found.unusable
        for name, value in self._wanted.items():
            self._params.set(name, value)
        left_out = (f"{place}; the line is kept and not used" for place in found.unknown)
        return (*problems, *(f"{error}; its default is used" for error in found.errors), *left_out)

    def save(self, tick: int, name: str) -> int | None:
        """Have the value in force of a parameter kept. A number to wait for; None when that is on disk already."""
        if not self._params.spec(name).kept:
            return None
        value = self._params[name]
        if self._wanted.get(name) != value:
            self._wanted[name] = value
            self._unusable = tuple(line for line in self._unusable if name not in re.split(r"[,\s]+", line))
        elif not self._watchdog.busy and self.failure is None:
            return None
        return self._put(tick)

    def saved(self, tick: int) -> Saved | None:
        """Result of a write, once."""
        return self._watchdog.saved(tick, self._note)

    def finish(self) -> None:
        self._note(self._watchdog.finish())

    def _note(self, error: Exception | None) -> None:
        self.failure = None if error is None else f"parameters are not saved: {self._file.path}: {error}"
        self.unsaved = "" if error is None else f"parameters not saved ({cause_of(error)})"

    def _put(self, tick: int) -> int:
        text = param_text(self._wanted, more=(*self._unknown, *self._unusable)).encode()
        self._number = self._watchdog.put(tick, _check_line(text) + text)
        return self._number

    def _loss_notices(self, found: ParamText | None, problems: list[str]) -> tuple[Loss, ...]:
        """Notices to operators before arming."""
        if problems and found is None:
            text = "stored parameters not loaded, defaults in force"
        elif problems:
            text = "stored parameters damaged, the copy before is in force"
        elif found is not None and found.unusable:
            count = len(found.unusable)
            text = f"{count} stored parameter{'s' if count > 1 else ''} not loaded, defaults in force"
        elif self._file.lost:
            text = "stored parameters were damaged in an earlier run"
        else:
            return ()
        return (Loss(text, self._accept),)

    def _accept(self, tick: int) -> None:
        self._worker.run(self._file.accept)
        if self._unusable:
            self._unusable = ()
            self._put(tick)

    def _parse(self, data: bytes) -> ParamText:
        if not data.strip():
            raise ValueError("is empty")
        head, _, rest = data.partition(b"\n")
        if head.startswith(_CHECK) and head + b"\n" != _check_line(rest):
            raise ValueError("is damaged, or was edited by hand with its first line left in it")
        try:
            return scan_params(data.decode("utf-8"), str(self._file.path))
        except UnicodeDecodeError as error:
            raise ValueError("is not UTF-8 text") from error


_CHECK = b"# CRC-32 of what follows; remove this line to edit by hand: "


def _check_line(text: bytes) -> bytes:
    """The first line of a file that a vehicle keeps."""
    return b"%s%08x\n" % (_CHECK, zlib.crc32(text))
