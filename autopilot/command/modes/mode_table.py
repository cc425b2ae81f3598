"""Table of flight modes. A new mode is a class, a line here, and a row in :mod:`autopilot.mavlink.flight_modes`."""

from autopilot.command.modes.automatic import HoldMode, MissionMode, ReturnMode, SurfaceMode, TakeoffMode
from autopilot.command.modes.circle import CircleMode
from autopilot.command.modes.guided import GuidedMode
from autopilot.command.modes.mode import FlightModeBehaviour
from autopilot.command.modes.piloted import DepthHoldMode, ManualMode, PositionMode, StabilizeMode
from autopilot.command.modes.surftrak import SurftrakMode

MODES: tuple[type[FlightModeBehaviour], ...] = (
    HoldMode,
    MissionMode,
    ReturnMode,
    SurfaceMode,
    TakeoffMode,
    ManualMode,
    StabilizeMode,
    DepthHoldMode,
    SurftrakMode,
    PositionMode,
    GuidedMode,
    CircleMode,
)

STEERED = frozenset(mode.name for mode in MODES if mode.steered)
"""Piloted modes: entering or leaving one changes the goal at once, and thrust follows no faster than a pilot's own."""
