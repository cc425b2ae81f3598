"""Decision of one tick: mode, arming and goal."""

from dataclasses import dataclass, replace
from typing import TypeAlias

from autopilot.control.thrust.by_hand import ByHand
from autopilot.core.messages import Goal, MissionProgress
from autopilot.mavlink.api import FlightMode
from autopilot.mission.items import Order

Pose: TypeAlias = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Decision:
    """Of the commander, for everything after it in the tick."""

    armed: bool
    mode: FlightMode
    goal: Goal | None
    blind_ascent: bool
    """Surface without a position: open-loop heave, everything else neutral."""
    progress: MissionProgress
    reached: tuple[int, ...]
    failsafes: int
    """Bits of :class:`autopilot.core.messages.Failsafe`."""
    drop_weight: bool = False
    """A failsafe requests the release of the drop weight."""
    ascent: Pose | None = None
    """Surface without the controller: up to here (north, east, depth, heading) by the simple station-keeping law."""
    by_hand: ByHand | None = None
    """Without a position: pilot command, without the controller."""
    motor_test: tuple[int, int] | None = None
    """Thruster by its place in the vehicle file and its pulse [us]: it alone turns, there is no goal."""
    orders: tuple[Order, ...] = ()
    """Of mission items passed on this tick, for what the vehicle carries."""
    hand_back: bool = False
    """A failsafe has given the thrusters to the flight controller below."""
    disarm_flight_controller: bool = False
    """The flight controller below is to be disarmed, until its heartbeat shows it."""

    @property
    def lasting(self) -> "Decision":
        """The same for the ticks until the next decision, without what happened on its tick only."""
        return replace(self, reached=(), orders=()) if self.reached or self.orders else self
