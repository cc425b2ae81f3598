"""Size of a mission, for the warning about a large one that no fence bounds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin
from autopilot.core.plan import PlanItem, has_shapes
from autopilot.mission.items import GoTo, LoiterTurns, Step, Surface
from autopilot.mission.validation import read_mission

FAR_M = 1000.0
"""Length, or distance from home, from which a mission without a fence is named with its size: a mistyped coordinate
makes a survey of kilometres, and only a fence would have refused it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionExtent:
    length_m: float
    """From place to place in the order of the plan, jumps not counted."""
    farthest_m: float
    """Largest horizontal distance from home."""

    @property
    def far(self) -> bool:
        return max(self.length_m, self.farthest_m) > FAR_M

    @property
    def text(self) -> str:
        """``of 18.2 km, 1.3 km from home,``, "" for one that is not far."""
        return f" of {self.length_m / 1e3:.1f} km, {self.farthest_m / 1e3:.1f} km from home," if self.far else ""


def extent_of(steps: Sequence[Step], home_ned_m: FloatArray) -> MissionExtent:
    """Of a mission in local metres; ``home_ned_m`` (3,)."""
    found = (_place(step) for step in steps)
    places = np.array([place[:2] for place in found if place is not None]).reshape(-1, 2)
    return MissionExtent(
        length_m=float(np.hypot(*np.diff(places, axis=0).T).sum()),
        farthest_m=float(np.hypot(*(places - home_ned_m[:2]).T).max(initial=0.0)),
    )


def unfenced_extent(mission: Sequence[PlanItem], fence: Sequence[PlanItem], origin: Origin) -> MissionExtent | None:
    """Extent of a plan file's mission, home at the origin, if it is far and without a fence."""
    if has_shapes(fence):
        return None
    steps, _ = read_mission(mission, origin)
    extent = extent_of(steps, np.zeros(3))
    return extent if extent.far else None


def _place(step: Step) -> FloatArray | None:
    if isinstance(step, LoiterTurns):
        return step.centre_ned_m
    return step.pos_ned_m if isinstance(step, GoTo | Surface) else None
