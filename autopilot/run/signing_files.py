"""Signing key and signing time on disk (:class:`autopilot.mavlink.api.SigningStore`).

``signing.key`` is the key in hex digits, readable by its owner only. ``signing.time`` is an upper bound of all
timestamps signed or accepted: it is written ahead, so that after a power cut no timestamp is used or accepted
twice.
"""

import os
import stat
import time
from pathlib import Path

from autopilot.core.background import BackgroundWorker
from autopilot.core.disk import cause_of
from autopilot.core.errors import ConfigError
from autopilot.core.latest_value_writer import LatestValueWriter
from autopilot.core.params import Saved
from autopilot.core.state_file import Loss, StateFile
from autopilot.mavlink.api import AHEAD_UNITS, UNITS_PER_S, SigningState
from autopilot.mavlink.signing import KEY_BYTES

KEY_FILE = "signing.key"
EPOCH_S = 1_420_070_400
"""2015-01-01 in Unix time."""


class SigningFiles:
    """One vehicle's. ConfigError for a key that cannot be used: no vehicle is open because a file is damaged."""

    def __init__(self, folder: Path, worker: BackgroundWorker | None = None, *, now_s: float | None = None) -> None:
        """``desk``: worker for disk access, None = read-only; ``now_s``: Unix time."""
        self._key = StateFile(folder / KEY_FILE, copies=False, private=True)
        self._time = StateFile(folder / "signing.time")
        key, warnings = self._read_key()
        kept, problems = self._time.read(_parse_time, set_aside=worker is not None)
        if problems and kept is not None:
            kept += AHEAD_UNITS  # the copy before the last: the last was at most this much later
        self.warnings = (*warnings, *problems)
        """Messages to operators."""
        self.losses: tuple[Loss, ...] = ()
        """The same, to be accepted before arming."""
        clock = max(0, round(((time.time() if now_s is None else now_s) - EPOCH_S) * UNITS_PER_S))
        self.state = SigningState(key, max(kept or 0, clock))
        """The state read at the start."""
        self._written = key
        self._worker = worker or BackgroundWorker()
        self._watchdog: LatestValueWriter[SigningState] = LatestValueWriter(self._worker, self._write)
        self.unsaved = ""
        """Why the time is not on disk, "" while it is."""
        if key is not None and worker is not None:
            self._begin(damaged=bool(problems) or self._time.lost)

    def _begin(self, *, damaged: bool) -> None:
        if damaged:
            text = "signing time damaged, the machine's clock is in force"
            self.losses = (Loss(text, lambda tick: self._worker.run(self._time.accept)),)
        try:
            self._write(SigningState(self.state.key, self.state.stamp + AHEAD_UNITS))
        except OSError as error:
            self._note(error)

    def _note(self, error: Exception | None) -> None:
        self.unsaved = "" if error is None else f"signing time not saved ({cause_of(error)})"

    @staticmethod
    def discard(folder: Path) -> None:
        """Take away a key that cannot be used. ConfigError when the disk does not let it."""
        path = folder / KEY_FILE
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be removed ({cause_of(error)}); check folder and rights") from error

    @property
    def path(self) -> Path:
        return self._key.path

    def keep(self, tick: int, state: SigningState) -> None:
        self._watchdog.put(tick, state)

    def poll(self, tick: int) -> Saved | None:
        return self._watchdog.saved(tick, self._note)

    def finish(self) -> None:
        self._note(self._watchdog.finish())

    def write_key(self, key: bytes | None) -> None:
        """Another key, None = none, at once. ConfigError when the disk does not take it."""
        try:
            self._write(SigningState(key, self.state.stamp))
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be written ({cause_of(error)}); check folder and rights") from error
        self.state = SigningState(key, self.state.stamp)

    def _read_key(self) -> tuple[bytes | None, tuple[str, ...]]:
        path = self.path
        try:
            mode, text = stat.S_IMODE(os.stat(path).st_mode), path.read_text(encoding="ascii", errors="replace").strip()
        except FileNotFoundError:
            return None, ()
        except NotADirectoryError as error:
            found = next(each for each in path.parents if each.exists())
            raise ConfigError(f"{found}: is not a folder; set state_dir to one") from error
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be read ({error.strerror}); it has to belong to the service's user"
            ) from error
        try:
            key = bytes.fromhex(text)
        except ValueError:
            key = b""
        if len(key) != KEY_BYTES:
            raise ConfigError(f"{path}: is no key of 64 hex digits; make another: `autopilot mavlink key make --force`")
        if mode & 0o077:
            return key, (f"{path} can be read by others: chmod 600, and make another key",)
        return key, ()

    def _write(self, state: SigningState) -> None:
        self._time.write(f"{state.stamp}\n".encode())
        if state.key == self._written:
            return
        if state.key is None:
            self._key.remove()
        else:
            self._key.write(state.key.hex().encode() + b"\n")
        self._written = state.key


def _parse_time(data: bytes) -> int:
    text = data.decode("ascii", errors="replace").strip()
    if not text.isdigit() or len(text) > 15:
        raise ValueError("is no signing time; the machine's clock is used")
    return int(text)
