"""Reassembly of long STATUSTEXT messages (MAVLink common.xml: id, chunk_seq, 50 characters each)."""

from dataclasses import dataclass, field
from typing import Any

CHUNK_CHARS = 50
FLUSH_S = 0.4
"""A text with missing chunks is passed on with a gap after this time."""
WARNING = 4
"""MAV_SEVERITY_WARNING: numbers up to this are complaints."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleText:
    t_s: float
    severity: int
    """MAV_SEVERITY."""
    text: str


@dataclass(slots=True)
class _Partial:
    begun_s: float
    severity: int
    chunks: dict[int, str] = field(default_factory=dict)


class TextCollector:
    """Reassembles STATUSTEXT chunks that may be lost, duplicated or reordered."""

    def __init__(self) -> None:
        self._partial: dict[int, _Partial] = {}
        self._done: dict[int, float] = {}

    @property
    def waiting(self) -> bool:
        """Whether a text is incomplete."""
        return bool(self._partial)

    def feed(self, message: Any, t_s: float) -> list[VehicleText]:
        """Texts that are complete with this message."""
        text = str(message.text)
        if message.id == 0:
            return [VehicleText(t_s=t_s, severity=message.severity, text=text)]
        if t_s - self._done.get(message.id, -1e9) < FLUSH_S:
            return []
        partial = self._partial.setdefault(message.id, _Partial(t_s, message.severity))
        partial.chunks[message.chunk_seq] = text
        last = max(partial.chunks)
        ended = len(partial.chunks[last]) < CHUNK_CHARS
        if not ended or len(partial.chunks) <= last:
            return []
        return [self._close(message.id, t_s)]

    def flush(self, t_s: float) -> list[VehicleText]:
        """Texts whose missing chunks did not arrive within ``FLUSH_S``, with a gap."""
        overdue = [key for key, partial in self._partial.items() if t_s - partial.begun_s >= FLUSH_S]
        return [self._close(key, t_s) for key in overdue]

    def _close(self, key: int, t_s: float) -> VehicleText:
        partial = self._partial.pop(key)
        self._done[key] = t_s
        pieces = [partial.chunks.get(k, "[...]") for k in range(max(partial.chunks) + 1)]
        return VehicleText(t_s=t_s, severity=partial.severity, text="".join(pieces))
