"""Energy of each thruster by the vehicle file's model: c |F|^1.5 of the acting thrust.

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
