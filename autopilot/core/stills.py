"""Still pictures: requests to the camera, their results, and the metadata in the log."""

from dataclasses import dataclass

from autopilot.core.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraReport:
    """State of the camera and of the storage of its stills."""

    frame_us: int | None
    """Exposure of the newest picture, None before the first."""
    total_bytes: int
    free_bytes: int
    """Of the disk that the stills go to."""
    refusal: str = ""
    """Why no still can be stored now, and what to do; "" = it can."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StoredStill:
    index: int
    """The service's number of it."""
    exposure_us: int
    """Time of its exposure; of the failure when there is no picture."""
    path: str = ""
    """Its file below the folder of logs, "" when there is none."""
    width_px: int = 0
    height_px: int = 0
    size: int = 0
    """Bytes as they are stored."""
    problem: str = ""
    """Why there is no picture, "" when there is."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StillRecord:
    """A still with where the vehicle was at its exposure, by the estimate."""

    t_us: int
    """When it was stored."""
    still: StoredStill
    seq: int
    """Mission item that asked for it, -1 = a client did."""
    pos_ned_m: FloatArray | None
    """(3,) None = not known."""
    rpy_rad: FloatArray | None
    """(3,)"""
    variance: FloatArray | None
    """(6,) of pos_ned and rpy."""
