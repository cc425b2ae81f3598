"""A ground station's .tlog of any vehicle through the attitude path: how regular its attitude is, and why it is not.

The file is read by pymavlink. ATTITUDE messages (https://mavlink.io/en/messages/common.html#ATTITUDE) become AHRS
samples, stamped by the sender's own clock, with the acceleration of the last RAW_IMU, and pass the same door as a
driver's. Every gap between two of them is explained by what the file itself shows: the sender's clock, sequence
numbers, other traffic, bytes that are no message.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.samples import AhrsSample
from autopilot.core.vehicle import load_vehicle
from estimator.inertial import GRAVITY_M_S2
from estimator.protocol import create_estimator

GAP_SHARE = 3.0
"""More than so many median intervals between two messages are a gap."""
EVEN_SHARE = 1.5
"""Up to so many median intervals the sender's own clock went on evenly."""
RAW_IMU_M_S2 = 1e-3 * GRAVITY_M_S2
"""One unit of RAW_IMU's accelerations as ArduPilot sends them (mG)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Two attitudes that are too far apart."""

    at_s: float
    """Since the first attitude, by arrival."""
    arrival_s: float
    sender_s: float
    """By the sender's clock."""
    lost: int
    """Packets of that sender that the sequence numbers miss meanwhile."""
    others: int
    """Packets of that sender that did come."""
    damaged: int
    """Pieces of the file that are no message."""

    def reason(self, median_s: float) -> str:
        """What the file shows of its cause, "" if nothing."""
        if self.sender_s <= 0.0:
            return "the sender started anew: its clock went back"
        if self.sender_s <= EVEN_SHARE * median_s:
            return "held up on the way: the sender went on evenly"
        causes = (
            (self.lost, "packets lost on the way"),
            (self.damaged, "damaged pieces in the file"),
            (self.others, "other packets sent instead"),
        )
        return ", ".join(f"{count} {what}" for count, what in causes if count)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TlogReplay:
    """What a file holds, by its first autopilot."""

    attitudes: int
    duration_s: float
    median_s: float
    """Interval by the sender's clock."""
    gaps: list[Gap]
    damaged: int
    """Pieces of the whole file that are no message."""
    counters: dict[str, int]
    """What the AHRS door made of the samples: ``ahrs.*``."""

    @property
    def unexplained(self) -> list[Gap]:
        """Gaps of which the file does not show the cause."""
        return [gap for gap in self.gaps if not gap.reason(self.median_s)]


@dataclass(slots=True)
class _Reading:
    samples: list[AhrsSample] = field(default_factory=list)
    arrivals_s: list[float] = field(default_factory=list)
    seen: list[tuple[int, int, int]] = field(default_factory=list)
    """At each attitude: packets lost, packets that came, damaged pieces so far."""
    damaged: int = 0


def replay_tlog(path: Path) -> TlogReplay:
    """Read and replay. LogError if the file cannot be read or holds fewer than two attitudes."""
    reading = _read(path)
    if len(reading.samples) < 2:
        raise LogError(f"{path}: holds {len(reading.samples)} ATTITUDE messages; give the .tlog of a flight")
    sender_s = np.diff([1e-6 * sample.t_us for sample in reading.samples])
    arrival_s = np.diff(reading.arrivals_s)
    median_s = float(np.median(sender_s[sender_s > 0.0])) if bool((sender_s > 0.0).any()) else 0.0
    gaps = []
    for n in np.flatnonzero((np.maximum(arrival_s, sender_s) > GAP_SHARE * median_s) | (sender_s <= 0.0)):
        before, after = reading.seen[n], reading.seen[n + 1]
        lost, others, damaged = (b - a for a, b in zip(before, after, strict=True))
        gaps.append(
            Gap(
                at_s=reading.arrivals_s[n] - reading.arrivals_s[0],
                arrival_s=float(arrival_s[n]),
                sender_s=float(sender_s[n]),
                lost=lost,
                others=others - 1,
                damaged=damaged,
            )
        )
    return TlogReplay(
        attitudes=len(reading.samples),
        duration_s=reading.arrivals_s[-1] - reading.arrivals_s[0],
        median_s=median_s,
        gaps=gaps,
        damaged=reading.damaged,
        counters=_through_the_door(reading.samples),
    )


def _through_the_door(samples: list[AhrsSample]) -> dict[str, int]:
    estimator = create_estimator("ekf", load_vehicle("lbv150"), None)
    now_us = 0
    for sample in samples:
        now_us = max(now_us, sample.t_us)
        estimator.step(now_us, (sample,), np.zeros(4))
    return {name: count for name, count in estimator.counters().items() if name.startswith("ahrs.")}


def _read(path: Path) -> _Reading:
    reading = _Reading()
    sender: tuple[int, int] | None = None
    lost = came = 0
    sequence: int | None = None
    accel = np.array([0.0, 0.0, -GRAVITY_M_S2])
    for message in _messages(path):
        kind = message.get_type()
        if kind == "BAD_DATA":
            reading.damaged += 1
            continue
        source = (message.get_srcSystem(), message.get_srcComponent())
        if sender is None and kind == "ATTITUDE":
            sender = source
        if source != sender:
            continue
        number = message.get_seq()
        lost += 0 if sequence is None else (number - sequence - 1) % 256
        came, sequence = came + 1, number
        if kind == "RAW_IMU":
            accel = RAW_IMU_M_S2 * np.array([message.xacc, message.yacc, message.zacc], dtype=float)
        elif kind == "ATTITUDE":
            reading.samples.append(
                AhrsSample(
                    t_us=1000 * message.time_boot_ms,
                    rpy_rad=np.array([message.roll, message.pitch, message.yaw]),
                    rate_frd_rad_s=np.array([message.rollspeed, message.pitchspeed, message.yawspeed]),
                    accel_frd_m_s2=accel,
                )
            )
            reading.arrivals_s.append(float(message._timestamp))
            reading.seen.append((lost, came, reading.damaged))
    return reading


def _messages(path: Path) -> Iterator[Any]:
    from pymavlink import mavutil

    try:
        log = mavutil.mavlink_connection(str(path))
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read as .tlog ({error}); check the name") from error
    try:
        while (message := log.recv_match()) is not None:
            yield message
    finally:
        log.close()
