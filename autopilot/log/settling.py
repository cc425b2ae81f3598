"""Overshoot and settling time at goals where the vehicle holds.

Evaluated are goals that stayed in force for at least HELD_S after the vehicle had entered their region (position
and heading). Settled: it stays within SETTLED of the region's size from then on.
"""

from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.log.analysis import FlightRecord, VehicleTrack, seconds, wrap

HELD_S = 4.0
SETTLED = 0.25
"""Share of the radius and of the heading that a goal accepts."""
REST_S = 1.0
"""Time for which it has to stay there to count as settled."""
APPROACH_M = 0.02
"""Within this distance of the position the direction of approach is undefined."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stay:
    seq: int
    """Mission item, -1 = none."""
    entered_s: float
    end_s: float
    overshoot_m: float
    """Farthest beyond the place, seen from where the region was entered."""
    accept_radius_m: float
    settled_after_s: float | None
    """Since the region was entered; None = it was not at rest when the goal ended."""


def stays(flight: FlightRecord) -> list[Stay]:
    goals = flight.table("/ctl/goal")
    if goals is None or not len(goals):
        return []
    keys = np.column_stack((goals["pos_ned_m"], goals["yaw_rad"], goals["yaw_free"], goals["seq"]))
    starts = np.flatnonzero(np.r_[True, (np.diff(np.nan_to_num(keys), axis=0) != 0.0).any(axis=1)])
    t_s, driven = seconds(goals), _driven(flight)
    found = []
    for place, start in enumerate(starts.tolist()):
        end_s = float(t_s[starts[place + 1]]) if place + 1 < len(starts) else flight.armed.end_s
        begin_s, end_s = max(float(t_s[start]), flight.armed.start_s), min(end_s, flight.armed.end_s)
        if end_s - begin_s >= HELD_S and not ((driven >= begin_s) & (driven <= end_s)).any():
            stay = _stay(flight.judged, goals[start], begin_s, end_s)
            found += [] if stay is None else [stay]
    return found


def _driven(flight: FlightRecord) -> FloatArray:
    """(n,) times at which a velocity goal was in force."""
    drive = flight.table("/ctl/drive")
    return np.zeros(0) if drive is None else seconds(drive)[drive["active"] != 0]


def _stay(track: VehicleTrack, goal: np.void, begin_s: float, end_s: float) -> Stay | None:
    """Evaluation of one goal; None if its region was not entered in time to stay there."""
    rows = slice(int(np.searchsorted(track.t_s, begin_s)), int(np.searchsorted(track.t_s, end_s)))
    t_s, off = track.t_s[rows], track.pos_ned_m[rows] - goal["pos_ned_m"]
    away = np.linalg.norm(off, axis=1)
    turned = np.zeros(len(t_s)) if goal["yaw_free"] else np.abs(wrap(track.rpy_rad[rows, 2] - goal["yaw_rad"]))
    inside = (away <= goal["accept_radius_m"]) & (turned <= goal["accept_yaw_rad"])
    if not inside.any():
        return None
    entry = int(np.argmax(inside))
    if end_s - t_s[entry] < HELD_S:
        return None
    toward = -off[entry] / away[entry] if away[entry] > APPROACH_M else np.zeros(3)
    moving = (away > SETTLED * goal["accept_radius_m"]) | (turned > SETTLED * goal["accept_yaw_rad"])
    late = np.flatnonzero(moving[entry:])
    rest_s = float(t_s[entry + late[-1]]) if len(late) else float(t_s[entry])
    return Stay(
        seq=int(goal["seq"]),
        entered_s=float(t_s[entry]),
        end_s=end_s,
        overshoot_m=max(float((off[entry:] @ toward).max()), 0.0),
        accept_radius_m=float(goal["accept_radius_m"]),
        settled_after_s=rest_s - float(t_s[entry]) if end_s - rest_s >= REST_S else None,
    )
