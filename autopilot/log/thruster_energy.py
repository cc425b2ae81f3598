"""Energy of each thruster by the vehicle file's model, c |F|^1.5 of the acting thrust, and work of the drag on the way.

Where the acting thrust is not known that of the commands is used. A thruster with losses takes more than this.
"""

from dataclasses import dataclass

import msgspec
import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import Vehicle
from autopilot.log.analysis import FlightRecord, Span, seconds

ATTACHMENT = "vehicle.json"
LEAST_WORK_J = 1.0
"""Least work for a share."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ThrusterPower:
    """Electrical power of the thrusters of a log."""

    names: tuple[str, ...]
    t_s: FloatArray
    power_w: FloatArray
    """(n, thrusters)"""
    hotel_w: float
    """Of everything else, by the vehicle file."""

    def energy_j(self, span: Span) -> FloatArray:
        """(thrusters,) taken in a span; each value holds until the next."""
        mine = span.holds(self.t_s)
        lasts_s = np.diff(self.t_s[mine], append=min(span.end_s, float(self.t_s[-1])) if mine.any() else 0.0)
        return self.power_w[mine].T @ np.maximum(lasts_s, 0.0)


def thruster_power(flight: FlightRecord) -> ThrusterPower | None:
    """Of a log, None where it has no vehicle file or no thrust. LogError if its vehicle file cannot be read."""
    raw, acting = flight.log.attachments.get(ATTACHMENT), flight.table("/sim/thrusters")
    table = flight.table("/out/thrusters") if acting is None else acting
    if raw is None or table is None or not len(table):
        return None
    try:
        vehicle = msgspec.json.decode(raw, type=Vehicle)
    except msgspec.MsgspecError as error:
        raise LogError(f"{flight.log.path}: attachment {ATTACHMENT} is damaged ({error})") from error
    drives = [thruster.drive for thruster in vehicle.thrusters]
    ahead = np.array([drive.power_w_n15 for drive in drives])
    astern = np.array([drive.reverse_power_w_n15 or drive.power_w_n15 for drive in drives])
    thrust = table["thrust_n"][:, : len(drives)]
    return ThrusterPower(
        names=tuple(thruster.name for thruster in vehicle.thrusters),
        t_s=seconds(table),
        power_w=np.where(thrust < 0.0, astern, ahead) * np.abs(thrust) ** 1.5,
        hotel_w=vehicle.hotel_power_w,
    )


@dataclass(frozen=True, slots=True)
class DragWork:
    """Of a mission, along surge, sway and heave.

    Same path, same speed over ground, drag by the vehicle file; not a flight without the current."""

    flown_j: float
    still_j: float


def drag_work(flight: FlightRecord) -> DragWork | None:
    """Of a log, None where it has no vehicle file or hardly moved. LogError if its vehicle file cannot be read."""
    raw, track = flight.log.attachments.get(ATTACHMENT), flight.judged.between(flight.mission)
    if raw is None or len(track.t_s) < 2:
        return None
    try:
        model = msgspec.json.decode(raw, type=Vehicle).model4
    except msgspec.MsgspecError as error:
        raise LogError(f"{flight.log.path}: attachment {ATTACHMENT} is damaged ({error})") from error
    linear, quadratic = np.array(model.linear_drag[:3]), np.array(model.quadratic_drag[:3])
    lasts_s = np.diff(track.t_s, append=track.t_s[-1])

    def work_j(speed_m_s: FloatArray) -> float:
        power_w = ((linear + quadratic * np.abs(speed_m_s)) * speed_m_s**2).sum(axis=1)
        return float(np.nansum(power_w * lasts_s))

    found = DragWork(work_j(track.vel_water_frd_m_s), work_j(track.vel_frd_m_s))
    return found if found.still_j >= LEAST_WORK_J else None
