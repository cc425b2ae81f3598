"""Requests of the page to the simulation. A real vehicle accepts none.

The browser sends one of the ``ControlRequest`` tables. The loop executes it between two ticks
(:mod:`autopilot.run.sitl_view`); the browser gets the result.
"""

import re
from typing import Annotated, Protocol, TypeAlias

import msgspec

from autopilot.core.errors import AutopilotError
from autopilot.core.frames import FloatArray
from autopilot.core.toml_table import Table
from autopilot.log.description import Point2
from autopilot.view.page_state import FlowView, Steerable

MAX_SPEED, MIN_SPEED = 20.0, 0.1
MAX_FLOW_M_S = 1.0
"""Flow that may be added each way."""

_Flow = Annotated[float, msgspec.Meta(ge=-MAX_FLOW_M_S, le=MAX_FLOW_M_S)]
_Place = Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]


class Pause(Table, frozen=True, kw_only=True, tag_field="do", tag="pause"): ...


class Go(Table, frozen=True, kw_only=True, tag_field="do", tag="go"): ...


class Speed(Table, frozen=True, kw_only=True, tag_field="do", tag="speed"):
    """Change the real-time factor."""

    value: Annotated[float, msgspec.Meta(ge=MIN_SPEED, le=MAX_SPEED)]


class Reset(Table, frozen=True, kw_only=True, tag_field="do", tag="reset"): ...


class DragCurrent(Table, frozen=True, kw_only=True, tag_field="do", tag="current"):
    """Flow that is added to the scenario's, everywhere: the last one counts."""

    north_m_s: _Flow
    east_m_s: _Flow


class DragObstacle(Table, frozen=True, kw_only=True, tag_field="do", tag="obstacle"):
    number: Annotated[int, msgspec.Meta(ge=1)]
    north_m: _Place
    east_m: _Place


class CallFault(Table, frozen=True, kw_only=True, tag_field="do", tag="fault"):
    fault: dict[str, object]
    """A scenario's ``[[fault]]`` table without ``at_s``."""


ControlRequest: TypeAlias = Pause | Go | Speed | Reset | DragCurrent | DragObstacle | CallFault


def moved_text(number: int, north_m: float, east_m: float) -> str:
    """The message of a :class:`DragObstacle`."""
    return f"Obstacle {number} moved to {north_m:.2f} N {east_m:.2f} E"


def added_text(north_m_s: float, east_m_s: float) -> str:
    """The message of a :class:`DragCurrent`."""
    return f"Current {north_m_s:+.2f} N {east_m_s:+.2f} E m/s added"


_MOVED = re.compile(r"View: Obstacle (\d+) moved to (-?[\d.]+) N (-?[\d.]+) E")
_ADDED = re.compile(r"View: Current ([+-][\d.]+) N ([+-][\d.]+) E m/s added")


def dragged(text: str) -> DragObstacle | DragCurrent | None:
    """What was dragged, to the centimetre [m] or centimetre per second, by the message in a log; None of others."""
    if found := _MOVED.fullmatch(text):
        return DragObstacle(number=int(found[1]), north_m=float(found[2]), east_m=float(found[3]))
    if found := _ADDED.fullmatch(text):
        return DragCurrent(north_m_s=float(found[1]), east_m_s=float(found[2]))
    return None


class ViewError(AutopilotError):
    """A request of the page cannot be executed."""


class Steered(msgspec.Struct, frozen=True, kw_only=True):
    """How things stand that can be steered."""

    paused: bool = False
    speed: float = 1.0
    extra_current_ned_m_s: Point2 | None = None


class Controls(Protocol):
    """Executes requests of the page."""

    @property
    def steerable(self) -> Steerable: ...

    @property
    def steered(self) -> Steered: ...

    def flow(self, t_s: float, pos_ned_m: FloatArray, shown_m: FloatArray) -> FlowView | None:
        """The simulated current at the vehicle's depth, round the vehicle (3,) and over the places (n, 2) that the
        plan shows; None on a real vehicle. From the view's thread."""
        ...

    def do(self, request: ControlRequest) -> str:
        """Execute a request on the loop and return the result. ViewError with the reason. Called by the page's
        threads.
        """
        ...


class ReadOnly:
    """A real vehicle: the page shows, and that is all."""

    steerable = Steerable(missing=("This is a real vehicle: the page only shows. Fly it from a ground station.",))
    steered = Steered()

    def flow(self, t_s: float, pos_ned_m: FloatArray, shown_m: FloatArray) -> FlowView | None:
        return None

    def do(self, request: ControlRequest) -> str:
        raise ViewError("this view is read-only: use a ground station")
