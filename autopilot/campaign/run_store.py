"""Folder of a campaign: identity, drawn scenarios, one line per finished run.

``campaign.json`` holds the identity, ``scenarios/run-0007.toml`` the scenario of run 7 (with its plan), and
``runs.jsonl`` (``runs-2of4.jsonl`` for a shard) one :class:`RunResult` per line, each written and synced at once. A
truncated last line is dropped. Shards are merged by copying their ``runs-*.jsonl`` into one's folder. World campaigns
and the fault campaign store their flights in the same way (:class:`ResultStore`).
"""

import errno
import os
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Generic, TypeVar

import msgspec

from autopilot.campaign.definition import Campaign, CampaignIdentity, first_difference
from autopilot.campaign.results import RunResult, Task
from autopilot.core.disk import write_whole
from autopilot.core.errors import ConfigError, LogError
from autopilot.log.lock import lock_exclusive

IDENTITY = "campaign.json"
RUNS = "runs*.jsonl"
GO_ON = "finished runs are kept; make room, and the same command goes on"

Result = TypeVar("Result")
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Shard:
    """Part ``index`` (from 1) of ``count``: every ``count``-th run."""

    index: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """From ``I/N``. ConfigError if it is malformed."""
        first, _, second = text.partition("/")
        if not (first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second)):
            raise ConfigError(f"--shard {text!r}: write I/N with I from 1 to N, such as 2/4")
        return cls(int(first), int(second))

    def holds(self, run: int) -> bool:
        """Whether a run (from 0) belongs to it."""
        return run % self.count == self.index - 1

    @property
    def file_name(self) -> str:
        return "runs.jsonl" if self.count == 1 else f"runs-{self.index}of{self.count}.jsonl"


class ResultStore(Generic[Result]):
    """File of results, one line of JSON each, locked by one process."""

    def __init__(
        self,
        path: Path,
        what: Callable[[Result], str],
        *,
        option: str,
        prepare: Callable[[Path], None] = lambda _: None,
    ) -> None:
        """``what``: noun for a result. ``prepare`` writes the other files of the folder. ``option``: what to
        change when the folder is locked. ConfigError: the folder holds another campaign, or is locked.
        LogError: damaged.
        """
        self._what = what
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            prepare(path.parent)
            self._file: IO[bytes] = path.open("ab")
        except OSError as error:
            raise ConfigError(f"{path.parent}: cannot be written ({error.strerror}); choose another --out") from error
        if not lock_exclusive(self._file):
            self._file.close()
            raise ConfigError(f"{path}: another process flies these runs now; wait for it or take another {option}")
        _drop_cut_line(path)

    def close(self) -> None:
        self._file.close()

    def append(self, result: Result) -> None:
        """Keep a finished run: one write, then on disk. LogError if the disk does not take it."""
        _append_line(self._file, msgspec.json.encode(result) + b"\n", self._what(result))


class Store(ResultStore[RunResult]):
    """A folder that is open for one shard."""

    def __init__(self, folder: Path, campaign: Campaign, shard: Shard) -> None:
        self._folder, self._identity = folder, campaign.identity
        super().__init__(
            folder / shard.file_name, lambda run: f"run {run.run}", option="--shard", prepare=self._prepare
        )

    def _prepare(self, folder: Path) -> None:
        scenarios = folder / "scenarios"
        scenarios.mkdir(exist_ok=True)
        settle_identity(folder / IDENTITY, self._identity, RUNS)
        write_whole(scenarios / self._identity.plan_name, self._identity.plan)

    def results(self) -> dict[int, RunResult]:
        """Finished runs of all shards in the folder, by number."""
        return read_results(self._folder)

    def begin(self, task: Task) -> None:
        """Store the scenario of a run before the flight. LogError if it cannot be written."""
        path = scenario_file(self._folder, task.run)
        try:
            write_whole(path, task.scenario_toml)
        except OSError as error:
            raise LogError(f"{path}: cannot be written ({error.strerror}); {GO_ON}") from error


def _append_line(file: IO[bytes], line: bytes, what: str) -> None:
    """Append a whole line and sync it, or leave the file unchanged. LogError names ``what`` is not stored."""
    number = file.fileno()
    end = os.fstat(number).st_size
    try:
        if os.write(number, line) < len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(number)
    except OSError as error:
        with suppress(OSError):
            os.ftruncate(number, end)
        raise LogError(f"{file.name}: {what} cannot be written ({error.strerror}); {GO_ON}") from error


def scenario_file(folder: Path, run: int) -> Path:
    """The drawn scenario of a run."""
    return folder / "scenarios" / f"run-{run:04d}.toml"


def read_identity(folder: Path) -> CampaignIdentity:
    """Identity of the campaign in a folder. ConfigError: no campaign; LogError: damaged."""
    path = folder / IDENTITY
    try:
        return msgspec.json.decode(path.read_bytes(), type=CampaignIdentity)
    except OSError as error:
        raise ConfigError(f"{folder}: holds no campaign ({IDENTITY} is not there); name a folder of --out") from error
    except msgspec.MsgspecError as error:
        raise LogError(f"{path}: damaged ({error}); fly the campaign again into another folder") from error


def read_results(folder: Path) -> dict[int, RunResult]:
    """Finished runs of all shards in a folder, in order. LogError names a line that is damaged."""
    found = read_lines(sorted(folder.glob(RUNS)), RunResult, lambda result: result.run)
    return dict(sorted(found.items()))


def read_lines(paths: Iterable[Path], kind: type[Result], key: Callable[[Result], Key]) -> dict[Key, Result]:
    """The results in files of lines, as far as there are: the last of each key, because a run that could not be
    flown is flown again. LogError names a damaged line.
    """
    found: dict[Key, Result] = {}
    for path in paths:
        try:
            whole, _, _ = path.read_bytes().rpartition(b"\n") if path.exists() else (b"", b"", b"")
        except OSError as error:
            raise LogError(f"{path}: cannot be read ({error.strerror}); it holds the finished runs") from error
        for number, line in enumerate(whole.splitlines(), 1):
            if not line:
                continue
            try:
                result = msgspec.json.decode(line, type=kind)
            except msgspec.MsgspecError as error:
                raise LogError(f"{path}:{number}: damaged ({error}); delete that line to fly its run again") from error
            found[key(result)] = result
    return found


def settle_identity(path: Path, mine: msgspec.Struct, lines: str) -> None:
    """Write the identity into a new folder; in an old one it has to be the same. ``lines``: what results are in."""
    data = msgspec.json.format(msgspec.json.encode(mine), indent=1)
    results = [file for file in path.parent.glob(lines) if file.stat().st_size]  # before: both may come meanwhile
    if not path.exists():
        if results:
            raise ConfigError(
                f"{path.parent}: holds {results[0].name} without {path.name}, so it is not known of what; copy the"
                f" {path.name} of its campaign there, or choose another --out"
            )
        fresh = path.with_suffix(f".{os.getpid()}")
        fresh.write_bytes(data)
        fresh.replace(path)
    try:
        old = msgspec.json.decode(path.read_bytes())
    except msgspec.MsgspecError as error:
        raise LogError(f"{path}: damaged ({error}); choose another --out") from error
    new = msgspec.json.decode(data)
    if isinstance(old, dict) and "files" not in old:  # of before they were noted
        new.pop("files", None)
    difference = first_difference(old, new, "")
    if difference:
        raise ConfigError(
            f"{path.parent}: holds another campaign: {difference}; choose another --out, or go on with what it was"
        )


def _drop_cut_line(path: Path) -> None:
    """A write that a crash cut off is no run."""
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole < len(data):
        os.truncate(path, whole)
