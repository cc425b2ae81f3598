"""The signing key and the signing time on disk (:class:`autopilot.mavlink.api.SigningStore`).

``signing.key`` is the key in hex digits, readable by its owner only. ``signing.time`` is a time that no frame has been
signed with yet: it is written ahead, so that after a power cut no time is used twice.
"""

import os
import stat
import time
from pathlib import Path

from autopilot.core.desk import Desk
from autopilot.core.disk import cause_of
from autopilot.core.errors import ConfigError
from autopilot.core.keeper import Keeper
from autopilot.core.state_file import StateFile
from autopilot.mavlink.api import AHEAD_UNITS, UNITS_PER_S, SigningState

KEY_BYTES = 32
EPOCH_S = 1_420_070_400
"""2015-01-01 in Unix time."""


class SigningFiles:
    """One vehicle's. ConfigError for a key that cannot be used: no vehicle is open because a file is damaged."""

    def __init__(self, folder: Path, desk: Desk | None = None, *, now_s: float | None = None) -> None:
        """``desk``: the lane of the disk, None = nothing is written, only looked at; ``now_s``: Unix time."""
        self._key = StateFile(folder / "signing.key", copies=False, private=True)
        self._time = StateFile(folder / "signing.time")
        key, warnings = self._read_key()
        kept, problems = self._time.read(_parse_time, set_aside=desk is not None)
        self.warnings = (*warnings, *problems)
        """What operators should know."""
        clock = max(0, round(((time.time() if now_s is None else now_s) - EPOCH_S) * UNITS_PER_S))
        self._state = SigningState(key, max(kept or 0, clock))
        self._written = key
        self._keeper: Keeper[SigningState] = Keeper(desk or Desk(), self._write)
        if key is not None and desk is not None:
            try:
                self._write(SigningState(key, self._state.stamp + AHEAD_UNITS))
            except OSError as error:
                raise ConfigError(
                    f"{self._time.path}: cannot be written ({cause_of(error)}); make room, check rights"
                ) from error

    @property
    def path(self) -> Path:
        """Of the key."""
        return self._key.path

    @property
    def state(self) -> SigningState:
        """As found."""
        return self._state

    def keep(self, tick: int, state: SigningState) -> None:
        """Have it written, beside the loop."""
        self._keeper.put(tick, state)

    def poll(self, tick: int) -> str | None:
        """What became of it: "" = written, else why not; None = nothing new."""
        kept = self._keeper.poll(tick)
        return None if kept is None else "" if kept.error is None else cause_of(kept.error)

    def finish(self) -> None:
        """The end of a run."""
        self._keeper.finish()

    def write_key(self, key: bytes | None) -> None:
        """Another key, None = none, at once. ConfigError when the disk does not take it."""
        try:
            self._write(SigningState(key, self._state.stamp))
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be written ({cause_of(error)}); check folder and rights") from error
        self._state = SigningState(key, self._state.stamp)

    def _read_key(self) -> tuple[bytes | None, tuple[str, ...]]:
        path = self.path
        try:
            mode, text = stat.S_IMODE(os.stat(path).st_mode), path.read_text(encoding="ascii", errors="replace").strip()
        except FileNotFoundError:
            return None, ()
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be read ({error.strerror}); it has to belong to the service's user"
            ) from error
        try:
            key = bytes.fromhex(text)
        except ValueError:
            key = b""
        if len(key) != KEY_BYTES:
            raise ConfigError(f"{path}: is no key of 64 hex digits; make another with `autopilot mavlink key make`")
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
