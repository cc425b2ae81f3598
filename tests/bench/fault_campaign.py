"""A machine-made study of sensor faults: kinds, alone and just before gaps in the markers, over seeds.

Every flight is one of the whole service (:mod:`tests.bench.sensor_faults`). A row sums up one fault with one gap.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.bench.sensor_faults import FaultFlight, FaultResult, fly_fault

SEEDS, SHORT_SEEDS = (51, 52, 53), (51,)
GAPS_S, SHORT_GAPS_S = (0.0, 1.0, 2.0, 3.0, 5.0), (0.0, 3.0)
CAMERA = ("accelerometer +1 m/s2 forward", "wrong tilt 0.1 rad", "lens 1.03", "mounting turned 0.1 rad")
"""Those that are flown with rendered pictures as well: what only a picture has (tilt, lens, mounting) counts there."""
CAMERA_GAPS_S = (0.0, 3.0)

Table = Mapping[str, Any]


def _offset(sensor: str, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Table:
    return {"kind": "imu_offset", "sensor": sensor, "offset": [x, y, z]}


def _scale(sensor: str, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Table:
    return {"kind": "imu_scale", "sensor": sensor, "factor": [x, y, z]}


def _stuck(sensor: str, axis: str) -> Table:
    return {"kind": "imu_stuck", "sensor": sensor, "axis": axis}


def _clip(sensor: str, limit: float) -> Table:
    return {"kind": "imu_clip", "sensor": sensor, "limit": limit}


FAULTS: dict[str, Table] = {
    "none": {},
    "accelerometer +0.3 m/s2 forward": _offset("accel", 0.3),
    "accelerometer +1 m/s2 forward": _offset("accel", 1.0),
    "accelerometer -2 m/s2 sideways": _offset("accel", 0.0, -2.0),
    "accelerometer +10 m/s2 forward": _offset("accel", 10.0),
    "accelerometer +30 m/s2 all axes": _offset("accel", 30.0, -30.0, 30.0),
    "accelerometer +0.3 m/s2 down": _offset("accel", 0.0, 0.0, 0.3),
    "accelerometer +1 m/s2 down": _offset("accel", 0.0, 0.0, 1.0),
    "accelerometer scale 0.9": _scale("accel", 0.9, 0.9, 0.9),
    "accelerometer x inverted": _scale("accel", -1.0),
    "accelerometer x stuck": _stuck("accel", "x"),
    "accelerometer y stuck": _stuck("accel", "y"),
    "accelerometer z stuck": _stuck("accel", "z"),
    "accelerometer clipped at 2 m/s2": _clip("accel", 2.0),
    "gyro +0.05 rad/s": _offset("gyro", 0.0, 0.0, 0.05),
    "gyro -0.3 rad/s": _offset("gyro", 0.0, 0.0, -0.3),
    "gyro +3 rad/s": _offset("gyro", 0.0, 0.0, 3.0),
    "gyro scale 0.5": _scale("gyro", 0.5, 0.5, 0.5),
    "gyro z stuck": _stuck("gyro", "z"),
    "gyro clipped at 0.05 rad/s": _clip("gyro", 0.05),
    "wrong tilt 0.1 rad": {"kind": "ahrs_attitude", "pitch_rad": -0.1},
    "wrong tilt 0.3 rad": {"kind": "ahrs_attitude", "roll_rad": 0.3},
    "wrong heading 0.1 rad": {"kind": "ahrs_attitude", "yaw_rad": 0.1},
    "wrong heading 3 rad": {"kind": "ahrs_attitude", "yaw_rad": 3.0},
    "lens 1.03": {"kind": "lens", "focal_factor": 1.03},
    "lens 0.9": {"kind": "lens", "focal_factor": 0.9},
    "mounting turned 0.1 rad": {"kind": "mounting", "rpy_rad": [0.0, 0.0, 0.1]},
    "mounting tilted 0.1 rad": {"kind": "mounting", "rpy_rad": [0.1, 0.0, 0.0]},
    "mounting off by 5 cm": {"kind": "mounting", "position_m": [0.05, 0.0, 0.0]},
    "markers moved by 0.3 m": {"kind": "markers_moved", "offset_m": [0.2, 0.2, 0.0]},
    "markers turned by 0.1 rad": {"kind": "markers_moved", "yaw_rad": 0.1},
}
"""Name -> the ``[[fault]]`` table without its times."""

HIDDEN = frozenset({"lens 1.03", "mounting tilted 0.1 rad", "mounting off by 5 cm", "markers moved by 0.3 m"})
"""Nothing on board measures these once the jump is over: a map, a lens or a mount that is a little wrong moves all
fixes alike. Promised instead: the jump is told, and the position is relative to the markers as they are seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRow:
    """One fault with one gap, over the seeds: the worst of each figure."""

    fault: str
    gap_s: float
    sensors: str
    flights: int
    inside_pct: float
    """Share of ticks with north, east, down and heading all inside 3 sigma."""
    error_m: float
    yaw_deg: float
    unflagged_s: float
    """Longest time far off, outside 3 sigma, and called good."""
    contacts: int
    resets: int
    blamed: bool
    kept: bool


def bench_sensor_faults(short: bool, show: Callable[[str], None] = lambda _: None) -> Iterator[CampaignRow]:
    """All faults with all gaps; ``short``: one seed, no gap and one of 3 s, no pictures."""
    seeds, gaps_s = (SHORT_SEEDS, SHORT_GAPS_S) if short else (SEEDS, GAPS_S)
    for name, table in FAULTS.items():
        for gap_s in gaps_s:
            show(f"{name}, gap {gap_s:g} s")
            yield _row(name, table, gap_s, seeds, "pose")
    for name in () if short else CAMERA:
        for gap_s in CAMERA_GAPS_S:
            show(f"{name}, gap {gap_s:g} s, pictures")
            yield _row(name, FAULTS[name], gap_s, seeds[:1], "camera")


def _row(name: str, table: Table, gap_s: float, seeds: Sequence[int], sensors: str) -> CampaignRow:
    faults = (table,) if table else ()
    flights = [FaultFlight(faults=faults, gap_s=gap_s, seed=seed, sensors=sensors) for seed in seeds]
    return _summed(name, gap_s, sensors, [fly_fault(flight) for flight in flights])


def _summed(name: str, gap_s: float, sensors: str, results: Sequence[FaultResult]) -> CampaignRow:
    return CampaignRow(
        fault=name,
        gap_s=gap_s,
        sensors=sensors,
        flights=len(results),
        inside_pct=100.0 * min(result.inside for result in results),
        error_m=max(result.worst_m for result in results),
        yaw_deg=math.degrees(max(result.worst_yaw_rad for result in results)),
        unflagged_s=max(result.unflagged_s for result in results),
        contacts=sum(result.contacts for result in results),
        resets=sum(result.resets for result in results),
        blamed=any(result.thrusters_blamed for result in results),
        kept=all(result.kept for result in results),
    )
