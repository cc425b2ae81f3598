"""Attitude regularity in a ground station's .tlog file, and the causes of gaps.

ATTITUDE messages (https://mavlink.io/en/messages/common.html#ATTITUDE) become AHRS samples, stamped by the sender's
own clock, with the acceleration of the last RAW_IMU, and pass the same validation as a driver's. Every gap between
two of them is explained by evidence in the file: the sender's clock, sequence numbers, other traffic, damaged
bytes.
"""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.samples import AhrsSample
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator.create import create_estimator
from autopilot.estimator.inertial import GRAVITY_M_S2
from autopilot.log.tlog_file import DamagedPiece, PacketOrigin, read_tlog

GAP_SHARE = 3.0
"""Median intervals between two messages beyond which there is a gap."""
EVEN_SHARE = 1.5
"""Median intervals up to which the sender's clock counts as regular."""
CLOCK_SET_S = 3600.0
"""Longest plausible network delay."""
RAW_IMU_M_S2 = 1e-3 * GRAVITY_M_S2
"""One unit of RAW_IMU's accelerations as ArduPilot sends them (mG)."""
LATE_FROM = 240
"""A sequence number so far ahead of the newest one is less than 16 behind it: overtaken, not after 240 lost ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeGap:
    """Two consecutive attitudes that are too far apart."""

    at_s: float
    """Since the first attitude, by arrival."""
    arrival_s: float
    sender_s: float
    """By the sender's clock."""
    lost: int
    """Packets of that sender that the sequence numbers miss meanwhile."""
    others: int
    """Packets received from that sender."""
    damaged: int
    """Damaged pieces of the file from that sender, or of unknown origin."""
    late: int = 0
    """Of these, packets of the sender that were overtaken or duplicated."""

    def reason(self, median_s: float) -> str:
        """Cause of the gap as shown by the file, "" if there is none. ``median_s``: median interval [s]."""
        if self.sender_s == 0.0:
            return "the same attitude twice" if self.late else "two attitudes with the same stamp"
        if self.sender_s < 0.0 and self.late:
            return "overtaken on the way by a later one"
        if self.sender_s < 0.0:
            return "the sender started anew: its clock went back"
        if self.sender_s <= EVEN_SHARE * median_s:
            if self.arrival_s > CLOCK_SET_S:
                return "the ground station's clock was set"
            return "held up on the way: the sender went on evenly"
        causes = (
            (self.lost, "packets lost on the way"),
            (self.damaged, "damaged pieces in the file"),
            (self.others, "other packets sent instead"),
        )
        return ", ".join(f"{count} {what}" for count, what in causes if count)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TlogReplay:
    """Regularity of the attitude of a .tlog file's first autopilot."""

    attitudes: int
    duration_s: float
    median_s: float
    """Interval by the sender's clock."""
    gaps: list[AttitudeGap]
    damaged: dict[str, int]
    """Kind of damage in the whole file -> count."""
    counters: dict[str, int]
    """Counters of the AHRS validation: ``ahrs.*``."""

    @property
    def unexplained(self) -> list[AttitudeGap]:
        """Gaps without a cause in the file."""
        return [gap for gap in self.gaps if not gap.reason(self.median_s)]


@dataclass(slots=True)
class _Reading:
    samples: list[AhrsSample] = field(default_factory=list)
    arrivals_s: list[float] = field(default_factory=list)
    seen: list[tuple[int, int, int, int]] = field(default_factory=list)
    """Up to each attitude: packets lost, received, damaged pieces, packets late or duplicated."""
    damaged: Counter[str] = field(default_factory=Counter)
    messages: int = 0


def replay_tlog(path: Path) -> TlogReplay:
    """Analyse the attitude messages of a .tlog file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    TlogReplay
        Of the first autopilot in the file.

    Raises
    ------
    LogError
        The file cannot be read or holds fewer than two attitudes.
    """
    reading = _read(path)
    if reading.messages == 0:
        raise LogError(f"{path}: holds no MAVLink message; give the .tlog of a ground station")
    if len(reading.samples) < 2:
        raise LogError(f"{path}: holds {len(reading.samples)} ATTITUDE messages; give the .tlog of a flight")
    sender_s = np.diff([1e-6 * sample.t_us for sample in reading.samples])
    arrival_s = np.diff(reading.arrivals_s)
    median_s = float(np.median(sender_s[sender_s > 0.0])) if bool((sender_s > 0.0).any()) else 0.0
    gaps = []
    for n in np.flatnonzero((np.maximum(arrival_s, sender_s) > GAP_SHARE * median_s) | (sender_s <= 0.0)):
        lost, others, damaged, late = (b - a for a, b in zip(*reading.seen[n : n + 2], strict=True))
        gaps.append(
            AttitudeGap(
                at_s=reading.arrivals_s[n] - reading.arrivals_s[0],
                arrival_s=float(arrival_s[n]),
                sender_s=float(sender_s[n]),
                lost=lost,
                others=others - 1,
                damaged=damaged,
                late=late,
            )
        )
    return TlogReplay(
        attitudes=len(reading.samples),
        duration_s=reading.arrivals_s[-1] - reading.arrivals_s[0],
        median_s=median_s,
        gaps=gaps,
        damaged=dict(reading.damaged.most_common()),
        counters=_through_the_door(reading.samples),
    )


def _through_the_door(samples: list[AhrsSample]) -> dict[str, int]:
    vehicle = load_vehicle("lbv150")
    estimator = create_estimator("ekf", vehicle, None)
    now_us = 0
    for sample in samples:
        now_us = max(now_us, sample.t_us)
        estimator.step(now_us, (sample,), np.zeros(len(vehicle.thrusters)))
    return {name: count for name, count in estimator.counters().items() if name.startswith("ahrs.")}


def _read(path: Path) -> _Reading:
    reading = _Reading()
    sender: tuple[int, int] | None = None
    link = _Link()
    accel = np.array([0.0, 0.0, -GRAVITY_M_S2])
    for piece in read_tlog(path):
        origin = piece.origin
        source = None if origin is None else (origin.system, origin.component)
        if isinstance(piece, DamagedPiece):
            reading.damaged[str(piece)] += 1
            if source is None or source == sender:
                link.damaged(origin)
            continue
        reading.messages += 1
        if sender is None and piece.origin.message == "ATTITUDE":
            sender = source
        if source != sender:
            continue
        link.came(piece.origin.sequence)
        message = piece.message
        if piece.origin.message == "RAW_IMU":
            accel = RAW_IMU_M_S2 * np.array([message.xacc, message.yacc, message.zacc], dtype=float)
        elif piece.origin.message == "ATTITUDE":
            reading.samples.append(
                AhrsSample(
                    t_us=1000 * message.time_boot_ms,
                    rpy_rad=np.array([message.roll, message.pitch, message.yaw]),
                    rate_frd_rad_s=np.array([message.rollspeed, message.pitchspeed, message.yawspeed]),
                    accel_frd_m_s2=accel,
                )
            )
            reading.arrivals_s.append(1e-6 * piece.at_us)
            reading.seen.append(link.counts)
    return reading


class _Link:
    """Counts lost, received and late packets of one sender by sequence number (one byte)."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._lost = self._came = self._damaged = self._late = 0

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Packets lost, received, damaged, late or duplicated."""
        return self._lost, self._came, self._damaged, self._late

    def came(self, sequence: int) -> None:
        self._came += 1
        self._follow(sequence)

    def damaged(self, origin: PacketOrigin | None) -> None:
        """A damaged piece: not lost as well, if its number can be read."""
        self._damaged += 1
        if origin is not None:
            self._follow(origin.sequence)

    def _follow(self, sequence: int) -> None:
        ahead = 1 if self._newest is None else (sequence - self._newest) % 256
        if ahead == 0 or ahead > LATE_FROM:
            self._late += 1
            return
        self._lost += ahead - 1
        self._newest = sequence
