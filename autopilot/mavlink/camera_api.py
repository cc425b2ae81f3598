"""Interface of the camera component to the vehicle, implemented by :mod:`autopilot.command.photographer`."""

from dataclasses import dataclass
from typing import Protocol

from autopilot.core.frames import FloatArray
from autopilot.core.stills import CameraReport, StillRecord
from autopilot.mavlink.api import CommandReply


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraIdentity:
    """The camera, which does not change."""

    vehicle: str
    width_px: int
    height_px: int
    r_frd_from_view: FloatArray
    """(3, 3) its own axes (x along the optical axis, y to the right of the picture, z down in it) in the body's."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraState:
    exposing: bool
    """A capture is in progress."""
    interval_s: float | None
    """Time between stills of a running sequence, None without one."""
    distance_m: float | None
    """Way between stills, None without."""
    count: int
    """Stills so far, failed ones included: the next one's number."""
    report: CameraReport | None
    """None before the first word of the camera."""


class CameraOrders(Protocol):
    """Requests to the camera, answered at once; the pictures follow (:meth:`take_records`)."""

    identity: CameraIdentity

    @property
    def state(self) -> CameraState: ...

    def shoot(self, count: int | None, interval_s: float) -> CommandReply:
        """A number of stills (None = until stopped) at an interval. Replaces a running sequence."""
        ...

    def stop(self) -> CommandReply:
        """End the sequence, by time or by distance."""
        ...

    def shoot_every(self, distance_m: float, *, now: bool) -> CommandReply:
        """A still after every distance [m] from the last one; 0 ends the sequence. ``now``: the first at once."""
        ...

    def record(self, index: int) -> StillRecord | None:
        """A still of this run by its number."""
        ...

    def take_records(self) -> tuple[StillRecord, ...]:
        """Stills stored since the last call."""
        ...
