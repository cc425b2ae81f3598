"""Message signing (https://mavlink.io/en/guide/message_signing.html): keys and timestamps.

Without a key nothing is signed, and signed frames are rejected because their key is unknown. With a key all
outgoing MAVLink 2 is signed, and only frames signed with the key are accepted, except RADIO_STATUS (radios cannot
sign), the service's own components and, with ``SIGN_LOCAL``, programs of this machine.

Timestamps count 10 us since 2015. They never decrease, and no frame is accepted twice, across restarts too: no
frame is sent or accepted with a timestamp beyond the one that :class:`autopilot.mavlink.api.SigningStore` has on
disk, and after a restart none at or below it. A client that follows the guide (next timestamp at least the latest
received: pymavlink, MAVSDK, QGroundControl) passes it after receiving one of our frames; a client with an
independent clock, once that has passed the start of the service.
"""

import hashlib
import hmac
from dataclasses import dataclass

from autopilot.core.clients import Reach
from autopilot.core.clock import TICK_US
from autopilot.core.crc import checksum
from autopilot.core.nondeterminism import NondeterminismRecorder, NondeterminismSource
from autopilot.mavlink.api import AHEAD_UNITS, UNITS_PER_S, SigningState, SigningStore
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.wire import SIGNATURE_BYTES, is_signed, message_id

KEY_BYTES = 32
OLD_UNITS = 60 * UNITS_PER_S
"""Maximum lag of a new sender's timestamp behind ours."""
RENEW_UNITS = UNITS_PER_S
"""The time on disk is renewed when less than this is left."""
SLOW_DISK_US = 1_000_000
"""A disk that is slow or fails must not block reception: timestamps beyond the one on disk are accepted then."""
MAX_STREAMS = 256
"""Senders whose time is remembered; when one is forgotten, its last time is the least for all that are not known."""
MAX_STAMP = (1 << 48) - 1
LATEST_STAMP = MAX_STAMP - 100 * OLD_UNITS
"""Later timestamps (the year 2104) are rejected: they would leave none for other senders."""

_TAG = 6
"""Bytes of the hash that are sent."""
_BEATS = 0x80
"""Link number of frames that go out beside the ticks: a sequence of their own."""
UNSIGNABLE = frozenset((mav.MAVLINK_MSG_ID_RADIO_STATUS, 166))
"""RADIO_STATUS and RADIO: telemetry radios put them into the stream and have no key (as in ArduPilot and pymavlink)."""


@dataclass(slots=True)
class Refusals:
    """Rejected frames, by reason."""

    unsigned: int = 0
    unknown_key: int = 0
    old: int = 0
    ahead: int = 0
    """Later than the time on disk: accepted as soon as that has been advanced."""


class Signing:
    """One per service: all links share key and time."""

    def __init__(
        self,
        store: SigningStore | None = None,
        patience: float = 1.0,
        nondeterminism: NondeterminismSource | None = None,
    ) -> None:
        """``patience``: speed of the service's time relative to its clients'. ``witness``: recorder of
        verification results, because a replay has no key.
        """
        self._nondeterminism: NondeterminismSource = (
            NondeterminismRecorder() if nondeterminism is None else nondeterminism
        )
        self._store, self._patience = store, patience
        found = SigningState(None, 0) if store is None else store.state
        self.key = found.key
        self._stamp = self._base = self._floor = found.stamp
        """``_floor``: lower bound for senders that are new in this run."""
        self._kept = found.stamp + AHEAD_UNITS
        """The time that the disk has been asked to keep,"""
        self._safe = self._kept if found.key is not None else found.stamp
        """and the one that it has."""
        self._requested = 0
        """Number of the last request to the disk,"""
        self._requested_us: int | None = None
        """since when it has been waited for, None = it is done,"""
        self._disk_fails = False
        """and whether it has refused."""
        self._beat_stamp = 0
        self._t_us = 0
        self._streams: LatestUsed[tuple[int, int, int], int] = LatestUsed(MAX_STREAMS, self._forget)
        self.local_may_be_silent = False
        """Programs of this machine need not sign (SIGN_LOCAL)."""
        self.refused = Refusals()

    @property
    def stamp(self) -> int:
        return max(self._stamp, self._base + int(self._t_us / 10 / self._patience))

    def tick(self, t_us: int) -> str | None:
        """Advance signing time. Returns an error of the disk to report, "" = key and time are on it."""
        self._t_us = t_us
        if self._store is None:
            return None
        if self.key is not None and self.stamp > self._kept - RENEW_UNITS:
            self._keep(self.stamp + AHEAD_UNITS)
        saved = self._store.poll(t_us // TICK_US)
        if saved is None:
            return None
        self._disk_fails = bool(saved.failure)
        if saved.number == self._requested:
            self._requested_us = None
            if not saved.failure:
                self._safe = self._kept
        return saved.failure

    def finish(self) -> None:
        """End of a run: nothing is sent or accepted any more; the next run continues from this time."""
        if self.key is not None:
            self._keep(max(self.stamp, self._beat_stamp) + 1)

    def set_key(self, key: bytes | None, stamp: int = 0) -> None:
        """Replace the key, None = no signing. The later of the timestamps is kept, also per sender: returning to an
        old key does not make old frames valid.
        """
        self._stamp = min(max(self.stamp, stamp), LATEST_STAMP)
        self.key = key
        self._keep(self.stamp + AHEAD_UNITS)

    def _keep(self, stamp: int) -> None:
        self._kept = stamp
        if self._store is None:
            return
        self._requested += 1
        if self._requested_us is None:
            self._requested_us = self._t_us
        self._store.keep(self._t_us // TICK_US, SigningState(self.key, stamp))

    def _forget(self, stamp: int) -> None:
        """A sender is not remembered any more: none of its frames may be new again."""
        self._floor = max(self._floor, stamp)

    def sign(self, frame: bytes, crc_extra: int, link: int, *, counted: bool = True) -> bytes:
        """Sign a MAVLink 2 frame. Not ``counted``: timestamps of other streams stay unchanged."""
        assert self.key is not None
        if counted:
            self._stamp = stamp = max(self._stamp + 1, self.stamp)
        else:
            self._beat_stamp = stamp = max(self._beat_stamp + 1, self.stamp)
        number = (link & 0x7F) | (0 if counted else _BEATS)
        return signed(frame, crc_extra, self.key, number, stamp)

    def admits(self, frame: bytes, reach: Reach) -> bool:
        """Whether to accept a complete frame with a valid checksum. Calling it consumes the frame's timestamp."""
        if not is_signed(frame):
            if self.key is None or reach is Reach.PROCESS or (reach is Reach.MACHINE and self.local_may_be_silent):
                return True
            if message_id(frame) in UNSIGNABLE:
                return True
            self.refused.unsigned += 1
            return False
        key = self.key
        if key is None or not self._nondeterminism.observe("signature", True, lambda: is_signed_with(key, frame)):
            self.refused.unknown_key += 1
            return False
        stream = (frame[-SIGNATURE_BYTES], frame[5], frame[6])
        stamp = int.from_bytes(frame[1 - SIGNATURE_BYTES : -_TAG], "little")
        last = self._streams.get(stream)
        if last is None:
            fresh = stamp > self._floor and stamp + OLD_UNITS >= self.stamp
        else:
            fresh = stamp > last
        if not fresh or stamp > LATEST_STAMP:
            self.refused.old += 1
            return False
        self._stamp = max(self._stamp, stamp)
        if not self._is_kept(stamp):
            self.refused.ahead += 1
            return False
        self._streams[stream] = stamp
        return True

    def _is_kept(self, stamp: int) -> bool:
        """Whether a frame of that timestamp is rejected after a restart at any moment. If not, the disk gets a later
        time on the next tick, and the client's next frame is accepted.
        """
        if self._store is None or stamp <= self._safe or self._disk_fails:
            return True
        return self._requested_us is not None and self._t_us - self._requested_us > SLOW_DISK_US


def signed(frame: bytes, crc_extra: int, key: bytes, number: int, stamp: int) -> bytes:
    """An unsigned MAVLink 2 frame, signed as link ``number`` at signing time ``stamp``."""
    body = bytes((frame[1], frame[2] | mav.MAVLINK_IFLAG_SIGNED)) + frame[3:-2]
    crc = checksum(body + bytes((crc_extra,)))
    text = frame[:1] + body + crc.to_bytes(2, "little") + bytes((number,)) + stamp.to_bytes(6, "little")
    return text + _tag(key, text)


def is_signed_with(key: bytes, frame: bytes) -> bool:
    """Whether a complete frame is signed with a key; its timestamp is not checked."""
    return is_signed(frame) and hmac.compare_digest(_tag(key, frame[:-_TAG]), frame[-_TAG:])


def _tag(key: bytes, text: bytes) -> bytes:
    return hashlib.sha256(key + text).digest()[:_TAG]
