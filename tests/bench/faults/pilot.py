"""A flight of the whole service with a ground station in the vehicle's own time, and what its ticks cost."""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import development as mav

from autopilot.client.plan_client import PlanUpload
from autopilot.core.clock import TICK_US
from autopilot.core.geodesy import geodetic_from_ned
from autopilot.core.messages import Inputs, Outputs
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.local_plan import (
    CircleTable,
    FenceTable,
    LocalPlan,
    OriginTable,
    PolygonTable,
    WaypointTable,
    plan_of_local,
)
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_model import PlanFile
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl

ARM, START, REPOSITION = 400, 300, 192
"""MAV_CMD_COMPONENT_ARM_DISARM, MAV_CMD_MISSION_START, MAV_CMD_DO_REPOSITION (common.xml)."""

LONGEST_WAIT_S = 120.0
"""Of the vehicle's time for anything that a flight waits for."""

HALF_SIDE_M = 30.0
"""The workspace of crowded waters is a square; start and goals lie on its diagonals and are left free."""

KEPT_FREE = ((0.0, 0.0), (22.0, 22.0), (-22.0, 20.0))
IN_THE_WAY = ((11.0, 11.0), (0.0, 21.0))
"""The first obstacles: no leg between those places is free."""


class Pilot:
    """A :class:`autopilot.run.outside.InProcessClient` that does what it is told."""

    def __init__(self) -> None:
        self._mav = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self._mav.robust_parsing = True
        self._out: list[Any] = []
        self._upload: PlanUpload | None = None
        self._last_s = -1.0
        self.inbox: list[Any] = []
        """Every message of the vehicle but its telemetry's most frequent."""

    def command(self, command: int, *params: float) -> None:
        self._out.append(mav.MAVLink_command_long_message(1, 1, command, 0, *(*params, *(0.0,) * 7)[:7]))

    def go_to(self, lat_deg: float, lon_deg: float, depth_m: float) -> None:
        place = (round(lat_deg * 1e7), round(lon_deg * 1e7), -depth_m)
        self._out.append(mav.MAVLink_command_int_message(1, 1, 6, REPOSITION, 0, 0, -1.0, 1.0, 0.0, np.nan, *place))

    def upload(self, kind: PlanKind, items: Sequence[PlanItem]) -> PlanUpload:
        self._upload = PlanUpload(kind, items)
        self._out += self._upload.begin(max(self._last_s, 0.0))
        return self._upload

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        t_s = t_us * 1e-6
        for data in received:
            for message in self._mav.parse_buffer(data) or ():
                if message.get_type() in ("STATUSTEXT", "COMMAND_ACK", "MISSION_ACK", "HEARTBEAT"):
                    self.inbox.append(message)
                if self._upload is not None and self._upload.outcome is None:
                    self._out += self._upload.handle(message, t_s)
        if self._upload is not None and self._upload.outcome is None:
            self._out += self._upload.tick(t_s)
        if int(t_s) != int(self._last_s):
            self._out.append(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        self._last_s = t_s
        out, self._out = self._out, []
        return [bytes(message.pack(self._mav)) for message in out]

    def texts(self) -> list[str]:
        """STATUSTEXTs so far (first chunks of long ones)."""
        return [m.text for m in self.inbox if m.get_type() == "STATUSTEXT" and not m.chunk_seq]


@dataclass(slots=True, kw_only=True)
class PilotedFlight:
    """A session at speed 0 with its pilot."""

    session: SitlSession
    pilot: Pilot
    outputs: Outputs | None = None
    t_us: int = 0
    step_s: list[float] = field(default_factory=list)
    """CPU time of the loop's thread in every ``Autopilot.step``."""
    control_s: list[float] = field(default_factory=list)
    """The controller's part of it."""
    waited_s: float = 0.0
    """CPU time that the loop has spent on waiting for answers."""
    on_tick: Callable[[Outputs], None] = lambda _: None

    def tick(self) -> Outputs:
        """One tick of the whole loop."""
        self.t_us += TICK_US
        self.control_s.append(0.0)
        self.outputs = self.session.runtime.tick(self.t_us)
        self.on_tick(self.outputs)
        return self.outputs

    def fly(self, seconds: float) -> None:
        """So much of the vehicle's time."""
        for _ in range(round(seconds * 1e6 / TICK_US)):
            self.tick()

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Until something is so. RuntimeError when it never is."""
        for _ in range(round(LONGEST_WAIT_S * 1e6 / TICK_US)):
            if condition():
                return
            self.tick()
        raise RuntimeError(f"{what}: not within {LONGEST_WAIT_S:g} s; the vehicle said {self.pilot.texts()[-3:]}")

    def upload(self, kind: PlanKind, items: Sequence[PlanItem]) -> None:
        """Until it is accepted."""
        exchange = self.pilot.upload(kind, items)
        self.until(lambda: exchange.outcome is not None, f"{kind.name.lower()} upload")
        assert exchange.outcome is not None
        if not exchange.outcome.accepted:
            raise RuntimeError(f"{kind.name.lower()} upload: {exchange.outcome.reason}")

    def start(self) -> None:
        nav = self.session.service
        self.until(lambda: nav.nav is not None, "a position")
        self.fly(2.0)
        for command, param in ((ARM, 1.0), (START, 0.0)):
            before = len(self.pilot.inbox)
            self.pilot.command(command, param)
            self.until(lambda c=command, n=before: self._answered(c, n) is not None, f"answer to command {command}")  # type: ignore[misc]
            if self._answered(command, before) != 0:
                raise RuntimeError(f"command {command} refused: {self.pilot.texts()[-3:]}")

    def _answered(self, command: int, since: int) -> int | None:
        acks = [m for m in self.pilot.inbox[since:] if m.get_type() == "COMMAND_ACK" and m.command == command]
        return acks[-1].result if acks else None

    def figures(self, of: Sequence[float], since: int = 0) -> str:
        """Median, 99th percentile and maximum in milliseconds."""
        ms = 1e3 * np.array(of[since:])
        return f"p50 {np.median(ms):.1f}, p99 {np.percentile(ms, 99):.1f}, max {ms.max():.1f} ms"

    def origin(self) -> OriginTable:
        """Of the local frame."""
        here = self.session.parts.plans.origin
        return OriginTable(lat_deg=here.lat_deg, lon_deg=here.lon_deg, alt_m=here.alt_m)


@contextmanager
def piloted(scenario: str, params: dict[str, float] | None = None) -> Iterator[PilotedFlight]:
    """A flight in lockstep, nothing shared, no log."""
    with tempfile.TemporaryDirectory() as folder:
        settings = flight_settings(folder, {"scenario": scenario, "sensors": "pose"})
        pilot = Pilot()
        session = open_sitl(settings, params or {}, log=False, peers=(pilot,))
        flight = PilotedFlight(session=session, pilot=pilot)
        _measure(flight)
        try:
            yield flight
        finally:
            session.close()


def _measure(flight: PilotedFlight) -> None:
    """Time the service's step, and the controller within it, on the loop's own clock of CPU time."""
    service, controller = flight.session.service, flight.session.parts.controller
    step = service.step

    def timed_step(inputs: Inputs) -> Outputs:
        began = time.thread_time() - flight.waited_s
        outputs = step(inputs)
        flight.step_s.append(time.thread_time() - flight.waited_s - began)
        return outputs

    flight.session.runtime.wrap_step(timed_step)
    for name in ("step", "tick"):
        setattr(controller, name, _timed(getattr(controller, name), flight))
    for worker in flight.session.parts.workers:
        worker.wait = _not_counted(worker.wait, flight)  # type: ignore[method-assign, assignment]


def _not_counted(wait: Callable[[Any], Any], flight: PilotedFlight) -> Callable[[Any], Any]:
    """Waiting for an answer that is due happens in lockstep only and is no work of the tick."""

    def waited(future: Any) -> Any:
        began = time.thread_time()
        try:
            return wait(future)
        finally:
            flight.waited_s += time.thread_time() - began

    return waited


def _timed(call: Callable[..., Any], flight: PilotedFlight) -> Callable[..., Any]:
    def timed(*args: Any, **kwargs: Any) -> Any:
        began = time.thread_time() - flight.waited_s
        result = call(*args, **kwargs)
        flight.control_s[-1] += time.thread_time() - flight.waited_s - began
        return result

    return timed


def crowded_plan(
    origin: OriginTable, obstacles: int, waypoints: int, seed: int, *, round_ones: bool = False
) -> PlanFile:
    """A mission between two corners of a square with so many octagons (or cylinders) in it.

    ``obstacles`` = 0: the same mission without a fence.
    """
    rng = np.random.default_rng(seed)
    centers: list[Any] = [np.array(place) for place in IN_THE_WAY[:obstacles]]
    while len(centers) < obstacles:
        center = rng.uniform(2.0 - HALF_SIDE_M, HALF_SIDE_M - 2.0, 2)
        if min(np.hypot(*(center - np.array(place))) for place in (*KEPT_FREE, *centers)) > 3.2:
            centers.append(center)
    angle = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side = HALF_SIDE_M
    square = PolygonTable(points_m=[(-side, -side), (side, -side), (side, side), (-side, side)], inclusion=True)
    octagons = [PolygonTable(points_m=[tuple(p) for p in (c + rim).tolist()], inclusion=False) for c in centers]
    circles = [CircleTable(x_m=float(c[0]), y_m=float(c[1]), radius_m=1.0) for c in centers]
    fence = FenceTable(polygon=[square, *([] if round_ones else octagons)], circle=circles if round_ones else [])
    corners = KEPT_FREE[1:]
    places = [corners[i % 2] for i in range(waypoints)]
    return plan_of_local(
        LocalPlan(
            origin=origin,
            waypoint=[WaypointTable(x_m=x, y_m=y, depth_m=0.6, speed_m_s=0.35) for x, y in places],
            fence=fence if obstacles else FenceTable(),
        )
    )


def on_its_way(flight: PilotedFlight, seconds: float) -> None:
    """Upload the paper's plan, start it and fly for a while."""
    plan = paper_plan(1)
    flight.upload(PlanKind.FENCE, plan.fence)
    flight.upload(PlanKind.MISSION, plan.mission)
    flight.start()
    flight.fly(seconds)


def go_to(flight: PilotedFlight, place_ned_m: tuple[float, float, float]) -> None:
    """Send a go-to in local coordinates."""
    lat, lon, _ = geodetic_from_ned(flight.session.parts.plans.origin, np.array(place_ned_m))
    flight.pilot.go_to(lat, lon, place_ned_m[2])
