"""Field values of records that are not attributes of one object, in field order."""

import math
from collections.abc import Iterable

from autopilot.core.messages import MAX_THRUSTERS, Authority, FlightControllerState, NavCounters, VelocityGoal
from autopilot.core.sensors import AID_SENSORS
from autopilot.core.stills import StillRecord
from autopilot.log.packing.parts import UINT16, UINT32, clip, padded

_OF_THE_FILTER = (
    *("resets", "clock.backwards", "thrust.malformed", "ahrs.good", "ahrs.malformed", "ahrs.future", "ahrs.old"),
    *("ahrs.stuck", "ahrs.blind_steps", "ahrs.tilt_disagreements"),
)
_OF_AN_AID = ("received", "fused", "rejected", "late", "duplicate", "future", "malformed", "resets")
_OF_FRAMES = (
    *("ok", "wrong_size", "wrong_type", "dark", "bright", "flat", "torn", "frozen", "dropped", "failed", "late"),
    *("foggy", "tilted"),
)
_OF_THE_REST = (
    *("markers.unknown", "markers.misfit", "markers.leaning", "shadow.disagreements", "doubt.accel"),
    *("doubt.gyro", "doubt.compass_jumps", "doubt.jumps", "devices.sensors", "devices.camera"),
    *("devices.thrusters", "devices.watchdog", "power.malformed"),
)
"""Names of counts, in the order of the fields of NavCounters; "" for places that are kept free."""


def _names() -> tuple[str, ...]:
    names = [*_OF_THE_FILTER]
    for what in _OF_AN_AID:
        names += [f"{sensor}.{what}" for sensor in AID_SENSORS] + [""] * (16 - len(AID_SENSORS))
    names += [f"frames.{what}" for what in _OF_FRAMES] + [""] * (16 - len(_OF_FRAMES))
    return (*names, *_OF_THE_REST)


COUNTER_NAMES = _names()
"""Of the values of NavCounters one by one, but for those of :data:`LAST_NAMES`."""
FIELD_DISTURBANCES = "ahrs.field_disturbances"
LAST_NAMES = ("faults", "other", FIELD_DISTURBANCES)
"""Behind them: all faults together, whatever has no place of its own, and what logs have not always had."""
_PLACED = frozenset((*COUNTER_NAMES, FIELD_DISTURBANCES))

_AUTHORITIES = tuple(Authority)
_ARMED = (False, True, None)
"""In the log by their place."""
_TEXT_BYTES, _PROBLEM_BYTES, _REFUSALS_BYTES = 64, 128, 512
"""Widths of the texts in Below."""
ALL_LINKS = 255
"""``MavlinkFrame.link`` of a broadcast."""


def counter_values(value: NavCounters) -> Iterable[int]:
    """Of NavCounters; missing counters are 0."""
    counts = [value.counts.get(name, 0) for name in COUNTER_NAMES]
    counts.append(sum(count for name, count in value.counts.items() if name.startswith("faults.")))
    placed = sum(count for name, count in value.counts.items() if name in _PLACED)
    counts.append(sum(value.counts.values()) - placed - counts[-1])
    counts.append(value.counts.get(FIELD_DISTURBANCES, 0))
    return (clip(count, UINT32) for count in counts)


def drive_values(value: VelocityGoal | None) -> Iterable[float]:
    """Of Drive; axes left to the position goal are NaN, None is a goal without velocities."""
    given = value or VelocityGoal()
    return (
        int(value is not None),
        given.north_m_s,
        given.east_m_s,
        given.turn_rad_s,
        math.nan if given.down_m_s is None else given.down_m_s,
        math.nan if given.yaw_rate_rad_s is None else given.yaw_rate_rad_s,
        given.yaw_trend_rad_s,
    )


def still_values(record: StillRecord) -> Iterable[float]:
    """Of Still: pose at the exposure, and result."""
    pos, rpy, variance, taken = record.pos_ned_m, record.rpy_rad, record.variance, record.still
    return (
        clip(taken.index, UINT32),
        record.seq,
        0 if taken.problem else 1,
        0 if pos is None else 1,
        *padded(() if pos is None else pos, 3),
        *padded(() if rpy is None else rpy, 3),
        *padded(() if variance is None else variance, 6),
        clip(taken.width_px, UINT16),
        clip(taken.height_px, UINT16),
        clip(taken.size, UINT32),
        (record.t_us - taken.exposure_us) * 1e-6,
    )


def below_values(value: FlightControllerState) -> Iterable[int | bytes]:
    """Of Below: state of the flight controller, texts cut to the length of the fields."""
    known = value.pulses_us[:MAX_THRUSTERS]
    return (
        _AUTHORITIES.index(value.authority),
        int(value.acts),
        len(known),
        *(clip(pulse, UINT16) for pulse in known),
        *(0,) * (MAX_THRUSTERS - len(known)),
        _text(value.text, _TEXT_BYTES),
        _text(value.problem, _PROBLEM_BYTES),
        _text("".join(f"{line}\n" for line in value.refusals), _REFUSALS_BYTES),
        _ARMED.index(value.armed),
        int(value.rival),
    )


def _text(text: str, width: int) -> bytes:
    """UTF-8 truncated to a number of bytes at a character boundary."""
    return text.encode(errors="replace")[:width].decode(errors="ignore").encode()


def frame_values(frame: tuple[bytes, int, int]) -> Iterable[int | bytes]:
    """Of MavlinkFrame: at most 280 bytes (a packet with signature), link (-1 = all) and client (0 = everyone there)."""
    data, link, client = frame
    return data, len(data), link if 0 <= link < ALL_LINKS else ALL_LINKS, client & UINT16
