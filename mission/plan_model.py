"""Plan independent of the file format: mission, fence, rally points and home."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from autopilot.core.errors import PlanError
from autopilot.core.geodesy import Origin, deg_from_e7, e7_from_deg, local_e4_from_m
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.items import Command, MavFrame

FLOAT32_MAX = 3.4028234e38
"""Parameters travel as 32-bit floats."""
INT32_MAX = 2**31 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFile:
    """Content of a plan file; items in wire units (degrees times 1e7 or local metres times 1e4)."""

    mission: tuple[PlanItem, ...] = ()
    fence: tuple[PlanItem, ...] = ()
    rally: tuple[PlanItem, ...] = ()
    home: Origin | None = None
    """Planned home position; of a tank plan also the local origin that it was drawn with."""

    def items(self, kind: PlanKind) -> tuple[PlanItem, ...]:
        return {PlanKind.MISSION: self.mission, PlanKind.FENCE: self.fence, PlanKind.RALLY: self.rally}[kind]

    def drawing_origin(self) -> Origin:
        """Local origin for checks without a vehicle.

        Returns
        -------
        Origin
            Home, else the first geodetic position in the plan, else latitude and longitude 0.
        """
        if self.home is not None:
            return self.home
        for item in (*self.fence, *self.mission, *self.rally):
            on_map = abs(item.x) <= 89 * 10**7 and abs(item.y) <= 180 * 10**7 and (item.x or item.y)
            if item.frame not in (MavFrame.MISSION, MavFrame.LOCAL_NED) and on_map:
                return Origin(lat_deg=deg_from_e7(item.x), lon_deg=deg_from_e7(item.y))
        return Origin(lat_deg=0.0, lon_deg=0.0)


def without_home(mission: Sequence[PlanItem]) -> tuple[PlanItem, ...]:
    """A mission whose first item is not home, numbered from 0: for formats that keep home elsewhere."""
    if not mission or not mission[0].is_home:
        return tuple(mission)
    jump = Command.DO_JUMP
    return tuple(
        replace(item, seq=item.seq - 1, param1=max(item.param1 - 1.0, 0.0))
        if item.command == jump
        else replace(item, seq=item.seq - 1)
        for item in mission[1:]
    )


def make_item(
    where: str,
    seq: int,
    frame: int,
    command: int,
    params: Sequence[float],
    autocontinue: bool = True,
) -> PlanItem:
    """An item from seven parameters in file units.

    Parameters
    ----------
    where
        File and item, for error messages.
    seq
        Number of the item, from 0.
    frame
        MAV_FRAME.
    command
        MAV_CMD.
    params
        (7,) in file units: latitude and longitude in degrees, or local metres.
    autocontinue
        Whether the mission continues after the item.

    Returns
    -------
    PlanItem
        In wire units.

    Raises
    ------
    PlanError
        A parameter does not fit a 32-bit float, or a coordinate is not finite or out of range.
    """
    for index, value in enumerate(params[:7]):
        if math.isfinite(value) and abs(value) > FLOAT32_MAX:
            raise PlanError(f"{where}: param{index + 1} = {value:g} does not fit a 32-bit float; correct it")
    x, y = (_coordinate(where, name, value, frame) for name, value in (("param5", params[4]), ("param6", params[5])))
    p1, p2, p3, p4 = params[:4]
    return PlanItem(
        seq=seq,
        frame=int(frame),
        command=int(command),
        param1=p1,
        param2=p2,
        param3=p3,
        param4=p4,
        x=x,
        y=y,
        z=params[6],
        autocontinue=int(autocontinue),
    )


def _coordinate(where: str, name: str, value: float, frame: int) -> int:
    """One horizontal coordinate in wire units."""
    if frame == MavFrame.MISSION and not math.isfinite(value):
        return 0
    if not math.isfinite(value):
        raise PlanError(f"{where}: {name} (a coordinate) is {value}; give a number")
    if frame == MavFrame.LOCAL_NED:
        scaled = local_e4_from_m(value)
    elif frame == MavFrame.MISSION:
        scaled = round(value)
    else:
        scaled = e7_from_deg(value)
    if abs(scaled) > INT32_MAX:
        raise PlanError(f"{where}: {name} (a coordinate) = {value:g} is out of range; give degrees or metres")
    return scaled
