"""The client's session against the service's real MAVLink server, plan store and sequencer, over a bad link in memory.

Time is virtual: it passes while the client waits. The vehicle under the server flies straight to its goal.
"""

from collections import deque
from typing import Any

import numpy as np

from autopilot.core.arming_reasons import ArmingReason, HealthComponent
from autopilot.core.frames import wrap_pi
from autopilot.core.geodesy import GeodeticPosition, Origin
from autopilot.core.messages import Event, MavlinkFrame, ProgressState
from autopilot.core.params import ParamSet
from autopilot.mavlink.api import CommandReply, CommandResult, FlightMode, VehicleView
from autopilot.mavlink.server import MavlinkServer
from autopilot.mission.sequencer import Sequencer
from autopilot.mission.store import Plans
from tests import plan_items
from tests.lossy_link import LinkConditions, LossyLink
from tests.mavlink.mavlink_harness import OK, TICK_US, RecordingVehicle, base_view

RADIUS_M = 0.3
ORIGIN = Origin(lat_deg=37.9755, lon_deg=23.7790)
_POINT = GeodeticPosition(lat_deg=ORIGIN.lat_deg, lon_deg=ORIGIN.lon_deg, alt_m=ORIGIN.alt_m)
PERFECT = LinkConditions()


class StraightVehicle(RecordingVehicle):
    """Arms, starts missions, and goes straight to every goal at 1 m/s; knows nothing else."""

    def __init__(self, plans: Plans, params: ParamSet) -> None:
        super().__init__()
        self.plans = plans
        self.sequencer = Sequencer(params)
        self.loaded = -1
        self.armed = False
        self.pos = np.array([-1.6, -0.35, 0.45])
        self.yaw = 0.0
        self.not_ready = ""
        self.starts = 0

    def _note(self, name: str, *args: Any) -> CommandReply:
        return CommandReply(result=CommandResult.UNSUPPORTED)

    def arm(self, force: bool) -> CommandReply:
        if self.not_ready and not force:
            return CommandReply(result=CommandResult.DENIED, reason=f"Arming denied: {self.not_ready}")
        self.armed = True
        return OK

    def disarm(self, force: bool) -> CommandReply:
        self.armed = False
        return OK

    def start_mission(self, first_seq: int | None) -> CommandReply:
        if not self.armed or not self.plans.steps():
            return CommandReply(result=CommandResult.DENIED, reason="Mission start refused: not armed or no mission")
        self.starts += 1
        self.sequencer.start(first_seq)
        return OK

    def tick(self, t_us: int) -> tuple[tuple[int, ...], VehicleView]:
        """Items reached, and what telemetry shows."""
        if self.plans.revision != self.loaded and self.sequencer.state is not ProgressState.ACTIVE:
            self.sequencer.load(self.plans.steps())
            self.loaded = self.plans.revision
        nav = plan_items.nav(*self.pos.tolist(), self.yaw, t_us)
        out = self.sequencer.step(t_us, nav)
        if out.goal is not None:
            off = out.goal.pos_ned_m - self.pos
            self.pos = self.pos + off * min(1.0, 0.01 / max(float(np.linalg.norm(off)), 1e-9))
            turn = 0.0 if out.goal.yaw_rad is None else wrap_pi(out.goal.yaw_rad - self.yaw)
            self.yaw = wrap_pi(self.yaw + max(-0.02, min(0.02, turn)))
        view = base_view(
            t_us=t_us,
            armed=self.armed,
            mode=FlightMode.HOLD,
            intended_mode=FlightMode.HOLD,
            nav=nav,
            power=None,
            command=None,
            progress=out.progress,
            target_ned_m=None,
            origin=_POINT,
            home=_POINT,
            arming_reasons=(
                (ArmingReason(f"plan: {self.plans.problem}", HealthComponent.MISSION),) if self.plans.problem else ()
            ),
            cpu_load=0.0,
        )
        return out.reached, view


class MemoryLink:
    """The client's link, and the world behind it."""

    def __init__(self, conditions: LinkConditions = PERFECT, seed: int = 1, profile: str = "px4") -> None:
        self.params = ParamSet()
        self.plans = Plans(self.params, RADIUS_M, ORIGIN)
        self.vehicle = StraightVehicle(self.plans, self.params)
        self.t_us = 0
        self.cut = False
        """True = nothing gets through in either direction."""
        self._up, self._down = LossyLink(conditions, seed), LossyLink(conditions, seed + 1000)
        self._arrived: deque[bytes] = deque()
        self.server = MavlinkServer(
            sysid=1,
            profile=profile,
            params=self.params,
            plans=self.plans,
            vehicle=self.vehicle,
            version="0.1.0",
            git="0",
            uid=1,
            links=(0,),
        )

    def clock_s(self) -> float:
        """Virtual seconds."""
        return self.t_us * 1e-6

    def send(self, data: bytes) -> None:
        """From the client."""
        self._post(self._up, data)

    def receive(self, timeout_s: float) -> bytes:
        """To the client; time passes until something comes."""
        end_us = self.t_us + round(timeout_s * 1e6)
        while True:
            self._arrived += self._down.take(self.t_us)
            if self._arrived:
                return self._arrived.popleft()
            if self.t_us >= end_us:
                return b""
            self.tick()

    def close(self) -> None:
        """Nothing to free."""

    def tick(self, events: tuple[Event, ...] = ()) -> None:
        """10 ms of the world."""
        self.t_us += TICK_US
        reached, view = self.vehicle.tick(self.t_us)
        rx = [MavlinkFrame(link=0, data=data) for data in self._up.take(self.t_us)]
        for frame in self.server.step(self.t_us, rx, view, events, reached):
            self._post(self._down, frame.data)

    def _post(self, link: LossyLink, data: bytes) -> None:
        if not self.cut:
            link.put(self.t_us, data)
