"""The three plans in force: mission, fence, rally. Replaced as a whole or not at all."""

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.plan import MissionResult, PlanItem, PlanKind, PlanRejection, PlanStore
from mission.decode import horizontal_ned_m, parse_step
from mission.fence import FenceShape, build_fence, read_fence
from mission.gaps import narrow_gaps
from mission.geodesy import Origin, geodetic_from_ned, ned_from_geodetic
from mission.items import Step
from mission.validation import PlanContext, check_item, gap_text, plan_problems


class WaterCheck(Protocol):
    """What is known of the water, as a judge of workspaces (a current map has to cover them)."""

    def problem(self, fence: Fence, steps: Sequence[Step], origin: Origin) -> str:
        """Why nothing may be flown there, "" if it may."""
        ...

    def warning(self, fence: Fence, steps: Sequence[Step]) -> str:
        """What the operator should know, "" if nothing."""
        ...


_ITEM = struct.Struct("<HBH4f2ifB")
"""What identifies an item, as wide as on the wire (MISSION_ITEM_INT)."""


def plan_checksum(items: tuple[PlanItem, ...]) -> int:
    """CRC-32 of a plan's content, 0 when it is empty: changes whenever the plan does, and survives a restart."""
    crc = 0
    for i in items:
        packed = _ITEM.pack(
            i.seq, i.frame, i.command, i.param1, i.param2, i.param3, i.param4, i.x, i.y, i.z, i.autocontinue
        )
        crc = zlib.crc32(packed, crc)
    return crc if not items else max(1, crc)


class Plans(PlanStore):
    """Implements :class:`PlanStore`; also gives the plans in local metres.

    ``params`` is read live: what a parameter allows is judged at upload and again by :meth:`recheck`.
    """

    def __init__(
        self,
        params: Mapping[str, float],
        radius_m: float,
        origin: Origin | None = None,
        water: WaterCheck | None = None,
    ) -> None:
        self._params = params
        self._water = water
        self._radius_m = radius_m
        self._origin = origin or Origin(
            lat_deg=params["ORIGIN_LAT"], lon_deg=params["ORIGIN_LON"], alt_m=params["ORIGIN_ALT"]
        )
        self._home_ned_m: FloatArray = np.zeros(3)
        self._home: Origin | None = None
        self._plans: dict[PlanKind, tuple[PlanItem, ...]] = dict.fromkeys(PlanKind, ())
        self._steps: tuple[Step, ...] = ()
        self._shapes: tuple[FenceShape, ...] = ()
        self.revision = 0
        """Grows by one whenever a plan or the origin changes."""

    @property
    def origin(self) -> Origin:
        """The local origin; its altitude is the water surface."""
        return self._origin

    @property
    def home_ned_m(self) -> FloatArray:
        """(3,) where RETURN goes, the origin until it is set."""
        return self._home_ned_m

    @property
    def home(self) -> Origin:
        """Home in geodetic coordinates; the same object until home or origin change."""
        if self._home is None:
            lat, lon, alt = geodetic_from_ned(self._origin, self._home_ned_m)
            self._home = Origin(lat_deg=lat, lon_deg=lon, alt_m=alt)
        return self._home

    def set_home(self, pos_ned_m: FloatArray) -> None:
        """New home (3,)."""
        self._home_ned_m = np.array(pos_ned_m, dtype=np.float64)
        self._home = None

    def items(self, kind: PlanKind) -> tuple[PlanItem, ...]:
        """The plan in force."""
        return self._plans[kind]

    def checksum(self, kind: PlanKind) -> int:
        """Opaque id of a plan (MAVLink mission protocol), 0 = empty."""
        return plan_checksum(self._plans[kind])

    def steps(self) -> tuple[Step, ...]:
        """The mission in local metres, one step per item."""
        return self._steps

    def fence(self) -> Fence:
        """The workspace in local metres with the depth band of the parameters; open water when there is no fence."""
        return build_fence(self._shapes, self._params)

    def rally_ned_m(self) -> FloatArray:
        """(n, 2) rally points."""
        points = [horizontal_ned_m(item, self._origin) for item in self._plans[PlanKind.RALLY]]
        return np.array(points).reshape(-1, 2)

    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the fence but tolerated by FENCE_GAP_CHK = 0, and what the water is like there."""
        texts: list[str] = []
        if not self._params["FENCE_GAP_CHK"]:
            texts += [gap_text(gap, self._radius_m) for gap in narrow_gaps(self._shapes, 2.0 * self._radius_m)]
        warning = "" if self._water is None else self._water.warning(self.fence(), self._steps)
        return (*texts, warning) if warning else tuple(texts)

    def check_item(self, kind: PlanKind, item: PlanItem) -> PlanRejection | None:
        """The cheap check of one item as it arrives."""
        return check_item(kind, item, self._origin)

    def replace(self, kind: PlanKind, items: tuple[PlanItem, ...]) -> PlanRejection | None:
        """Check a whole plan, also against the other plans, and take it; or refuse it and keep the one in force."""
        rejection = next(self._problems(kind, {**self._plans, kind: items}, self._origin), None)
        if rejection is None:
            self._plans[kind] = items
            self._derive()
        return rejection

    def set_origin(self, origin: Origin) -> PlanRejection | None:
        """Move the local origin. Refused when a plan in force would not fit it. Home stays the same local point."""
        rejection = next(self._all_problems(origin), None)
        if rejection is None:
            self._origin = origin
            self._home = None
            self._derive()
        return rejection

    def recheck(self) -> PlanRejection | None:
        """Whether the plans in force still satisfy the parameters (depth band, speed, gap check): for arming."""
        return next(self._all_problems(self._origin), None)

    def local_ned_m(self, lat_deg: float, lon_deg: float, alt_m: float) -> FloatArray:
        """A geodetic position in local metres (3,)."""
        return ned_from_geodetic(self._origin, lat_deg, lon_deg, alt_m)

    def _derive(self) -> None:
        self._steps = tuple(parse_step(item, self._origin) for item in self._plans[PlanKind.MISSION])
        self._shapes = read_fence(self._plans[PlanKind.FENCE], self._origin)[0]
        self.revision += 1

    def _all_problems(self, origin: Origin) -> Iterator[PlanRejection]:
        for kind in PlanKind:
            yield from self._problems(kind, self._plans, origin)

    def _problems(
        self, kind: PlanKind, plans: Mapping[PlanKind, tuple[PlanItem, ...]], origin: Origin
    ) -> Iterator[PlanRejection]:
        """What is wrong with one plan among the others, lazily: the first finding is enough to refuse."""
        ctx = PlanContext(origin=origin, params=self._params, radius_m=self._radius_m)
        found = False
        for problem in plan_problems(kind, plans, ctx):
            found = True
            yield problem
        if self._water is not None and not found and plans[kind] and kind is not PlanKind.RALLY:
            steps = [parse_step(item, origin) for item in plans[PlanKind.MISSION]]
            fence = build_fence(read_fence(plans[PlanKind.FENCE], origin)[0], self._params)
            reason = self._water.problem(fence, steps, origin)
            if reason:
                yield PlanRejection(seq=0, result=MissionResult.INVALID, reason=reason)
