"""Message signing (https://mavlink.io/en/guide/message_signing.html): who has the key, and whether a frame is new.

Without a key nothing is signed, and a frame that is signed comes from somebody whose key is not known: it is not
obeyed. With a key everything that goes out as MAVLink 2 is signed, and only what is signed with the key is heard, but
for the status of radios, which cannot sign, the service's own parts, and, where ``SIGN_LOCAL`` says so, programs of
this machine.

Time counts in 10 us since 2015. It never goes back: :class:`autopilot.mavlink.api.SigningStore` has more on disk than
has been used.
"""

import hashlib
import hmac
from dataclasses import dataclass

from autopilot.core.clients import Reach
from autopilot.core.clock import TICK_US
from autopilot.core.crc import checksum
from autopilot.core.witness import Noted, Witness
from autopilot.mavlink.api import AHEAD_UNITS, UNITS_PER_S, SigningState, SigningStore
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.table import LatestUsed

KEY_BYTES = 32
OLD_UNITS = 60 * UNITS_PER_S
"""A sender not heard before may be so far behind our time."""
RENEW_UNITS = 30 * UNITS_PER_S
"""It is renewed when less than this is left."""
MAX_STREAMS = 256
"""Senders whose time is remembered; one that was forgotten has to be less than a minute old."""
MAX_STAMP = (1 << 48) - 1

_SIGNED = mav.MAVLINK_IFLAG_SIGNED
_V1 = mav.PROTOCOL_MARKER_V1
_BLOCK = mav.MAVLINK_SIGNATURE_BLOCK_LEN
_TAG = 6
"""Bytes of the hash that are sent."""
_BEATS = 0x80
"""Link number of frames that go out beside the ticks: a sequence of their own."""
UNSIGNABLE = frozenset((mav.MAVLINK_MSG_ID_RADIO_STATUS, 166))
"""RADIO_STATUS and RADIO: telemetry radios put them into the stream and have no key (as in ArduPilot and pymavlink)."""


@dataclass(slots=True)
class Refusals:
    """Frames that were not believed, by reason."""

    unsigned: int = 0
    unknown_key: int = 0
    old: int = 0


class Signing:
    """One per service: all links share key and time."""

    def __init__(
        self, store: SigningStore | None = None, patience: float = 1.0, witness: Witness | None = None
    ) -> None:
        """``patience``: how much faster than its clients' time the service's may run. ``witness`` stands by when
        signatures are verified: a replay has no key."""
        self._witness: Witness = Noted() if witness is None else witness
        self._store, self._patience = store, patience
        found = SigningState(None, 0) if store is None else store.state
        self.key = found.key
        self._stamp = self._base = found.stamp
        self._kept = found.stamp + AHEAD_UNITS
        self._beat_stamp = 0
        self._t_us = 0
        self._streams: LatestUsed[tuple[int, int, int], int] = LatestUsed(MAX_STREAMS)
        self.local_may_be_silent = False
        """Programs of this machine need not sign (SIGN_LOCAL)."""
        self.refused = Refusals()

    @property
    def stamp(self) -> int:
        """Signing time now."""
        return max(self._stamp, self._base + int(self._t_us / 10 / self._patience))

    def tick(self, t_us: int) -> str | None:
        """Time goes on; what there is to tell of the disk, "" = the key is on it."""
        self._t_us = t_us
        if self._store is None:
            return None
        if self.key is not None and self.stamp > self._kept - RENEW_UNITS:
            self._keep()
        return self._store.poll(t_us // TICK_US)

    def set_key(self, key: bytes | None, stamp: int = 0) -> None:
        """Another key from now on, None = none. The time goes on from the later one, and that of every sender with it:
        a key that comes back does not make old frames new."""
        self._stamp = min(max(self.stamp, stamp), MAX_STAMP - 100 * OLD_UNITS)
        self.key = key
        self._keep()

    def _keep(self) -> None:
        self._kept = self.stamp + AHEAD_UNITS
        if self._store is not None:
            self._store.keep(self._t_us // TICK_US, SigningState(self.key, self._kept))

    def sign(self, frame: bytes, crc_extra: int, link: int, *, counted: bool = True) -> bytes:
        """An unsigned MAVLink 2 frame, signed. What is not ``counted`` leaves the time of others as it is."""
        assert self.key is not None
        if counted:
            self._stamp = stamp = max(self._stamp + 1, self.stamp)
        else:
            self._beat_stamp = stamp = max(self._beat_stamp + 1, self.stamp)
        body = bytes((frame[1], frame[2] | _SIGNED)) + frame[3:-2]
        crc = checksum(body + bytes((crc_extra,)))
        number = (link & 0x7F) | (0 if counted else _BEATS)
        text = frame[:1] + body + crc.to_bytes(2, "little") + bytes((number,)) + stamp.to_bytes(6, "little")
        return text + _tag(self.key, text)

    def admits(self, frame: bytes, reach: Reach) -> bool:
        """Whether a whole frame with a good checksum is to be heard. Its time is used up by being asked for."""
        if frame[0] == _V1 or not frame[2] & _SIGNED:
            if self.key is None or reach is Reach.PROCESS or (reach is Reach.MACHINE and self.local_may_be_silent):
                return True
            number = frame[5] if frame[0] == _V1 else int.from_bytes(frame[7:10], "little")
            if number in UNSIGNABLE:
                return True
            self.refused.unsigned += 1
            return False
        key = self.key
        if key is None or not self._witness.ask(
            "signature", True, lambda: hmac.compare_digest(_tag(key, frame[:-_TAG]), frame[-_TAG:])
        ):
            self.refused.unknown_key += 1
            return False
        stream = (frame[-_BLOCK], frame[5], frame[6])
        stamp = int.from_bytes(frame[1 - _BLOCK : -_TAG], "little")
        last = self._streams.get(stream)
        fresh = stamp + OLD_UNITS >= self.stamp if last is None else stamp > last
        if fresh or last is not None:
            self._streams[stream] = stamp if last is None else max(stamp, last)
        if not fresh:
            self.refused.old += 1
            return False
        if stamp <= MAX_STAMP - 100 * OLD_UNITS:
            self._stamp = max(self._stamp, stamp)
        return True


def _tag(key: bytes, text: bytes) -> bytes:
    return hashlib.sha256(key + text).digest()[:_TAG]
