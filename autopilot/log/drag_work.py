"""Work of the drag over the path flown, in the moving water and as if it had been still.

Same path, same speed over ground, drag by the vehicle file; not a flight without the current.
"""

from dataclasses import dataclass

import msgspec
import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import Vehicle
from autopilot.log.analysis import FlightRecord
from autopilot.log.thruster_energy import ATTACHMENT

LEAST_WORK_J = 1.0
"""Least work for a share."""


@dataclass(frozen=True, slots=True)
class DragWork:
    """Of a mission, along surge, sway and heave."""

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
