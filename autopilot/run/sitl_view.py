"""The live view of a simulated run: ground truth, and interventions from the page.

Requests of the page are executed by the loop between two ticks. Every one is reported to the operator and logged,
because the run is then no longer the scenario's alone.
"""

import queue
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NoAnswer

import msgspec

from autopilot.command.service_parts import ServiceParts
from autopilot.core import operator_messages as notices
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.notice_queue import NoticeQueue
from autopilot.log.description import RunDescription
from autopilot.log.log_session import LoggedTruth
from autopilot.run.clocks import LockstepClock, PacedClock
from autopilot.run.sitl_world_view import flow_view, solid_views
from autopilot.run.world import WatchedService
from autopilot.sitl.backend import SimulatedVehicle
from autopilot.sitl.scenario_tables import Fault, Scenario
from autopilot.view.controls import (
    CallFault,
    ControlRequest,
    DragCurrent,
    DragObstacle,
    Go,
    Pause,
    Reset,
    Speed,
    Steered,
    ViewError,
    added_text,
    moved_text,
)
from autopilot.view.page_state import FaultOffer, FlowView, Solid, Steerable

ANSWER_S = 5.0
"""The loop answers an ask in that time, or is busy."""


class WatchedSitl(WatchedService):
    def __init__(self, parts: ServiceParts, describe: Callable[[], RunDescription], vehicle: SimulatedVehicle) -> None:
        super().__init__(parts, describe)
        self._vehicle = vehicle

    def truth(self) -> LoggedTruth | None:
        return self._vehicle.truth

    def solids(self) -> tuple[Solid, ...]:
        plant = self._vehicle.steerable
        return () if plant is None else solid_views(plant.solids)


class Steering(NoticeQueue):
    """Executes requests of the page. ``do`` is called by the page's threads, everything else by the loop."""

    def __init__(self, scenario: Scenario, vehicle: SimulatedVehicle, clock: PacedClock | LockstepClock) -> None:
        super().__init__()
        self._scenario, self._vehicle, self._clock = scenario, vehicle, clock
        self._requests: queue.SimpleQueue[tuple[ControlRequest, Future[str]]] = queue.SimpleQueue()
        self._speed = clock.speed if isinstance(clock, PacedClock) else 0.0
        self._paused = False
        self._flow_m_s = (0.0, 0.0)
        self._over = False
        self.reset = False
        """A restart of the run is requested."""

    # The page's side

    @property
    def steerable(self) -> Steerable:
        """Interventions that this simulation supports."""
        own_plant, paced = self._vehicle.steerable is None, isinstance(self._clock, PacedClock)
        missing = ["Waves and a tether cannot be changed in this simulation."]
        if own_plant:
            missing = ["This plant has no handles for current, obstacles and faults (sitl/protocol.py)."]
        if not paced:
            missing.append("No speed: the run goes as fast as possible (--speed 0).")
        return Steerable(
            pause=True,
            speed=paced,
            reset=True,
            current=not own_plant,
            obstacles=not own_plant and bool(self._scenario.obstacle),
            faults=() if own_plant else self._faults(),
            missing=tuple(missing),
        )

    @property
    def steered(self) -> Steered:
        flow = None if self._vehicle.steerable is None else self._flow_m_s
        return Steered(paused=self._paused, speed=self._speed, extra_current_ned_m_s=flow)

    def flow(self, t_s: float, pos_ned_m: FloatArray, shown_m: FloatArray) -> FlowView | None:
        plant = self._vehicle.steerable
        return None if plant is None else flow_view(plant.current_at, self._scenario.tank, t_s, pos_ned_m, shown_m)

    def do(self, request: ControlRequest) -> str:
        """Hand it to the loop and wait for its answer."""
        if self._over:
            raise ViewError("the run is over")
        answer: Future[str] = Future()
        self._requests.put((request, answer))
        try:
            return answer.result(ANSWER_S)
        except NoAnswer:
            answer.cancel()
            raise ViewError("the simulation is too busy to answer; try again") from None

    # The loop's side

    def hold(self, t_us: int) -> bool:
        """Execute requests since the last tick, at ``t_us``; whether the simulation is paused."""
        while not self._requests.empty():
            request, answer = self._requests.get()
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                answer.set_result(self._done(t_us, request))
            except (ConfigError, ViewError) as error:
                answer.set_exception(ViewError(str(error)))
        return self._paused

    def end(self) -> None:
        """The run is over: release threads that wait for an answer."""
        self._over = True
        while not self._requests.empty():
            _, answer = self._requests.get()
            if answer.set_running_or_notify_cancel():
                answer.set_exception(ViewError("the run is over"))

    def _done(self, t_us: int, request: ControlRequest) -> str:
        match request:
            case Pause():
                text, self._paused = "Paused", True
            case Go():
                text, self._paused = "Goes on", False
                self._pace(t_us)
            case Speed(value=value):
                if not isinstance(self._clock, PacedClock):
                    raise ViewError("a run with --speed 0 has no clock; start it with --speed 1")
                text, self._speed = f"Speed {value:g}", value
                self._pace(t_us)
            case Reset():
                self.reset = True
                return "Reset"
            case DragCurrent(north_m_s=north, east_m_s=east):
                text = self._add_flow(north, east)
            case DragObstacle(number=number, north_m=north, east_m=east):
                self._vehicle.put_obstacle(number, north, east)
                text = moved_text(number, north, east)
            case CallFault(fault=fault):
                text = self._call(t_us, fault)
        self._notices.append(notices.VIEW(text=text))
        return text

    def _pace(self, t_us: int) -> None:
        if isinstance(self._clock, PacedClock):
            self._clock.go_on(t_us, self._speed)

    def _add_flow(self, north_m_s: float, east_m_s: float) -> str:
        self._vehicle.add_flow((north_m_s, east_m_s))
        self._flow_m_s = (north_m_s, east_m_s)
        return added_text(north_m_s, east_m_s)

    def _call(self, t_us: int, table: dict[str, object]) -> str:
        try:
            fault: Fault = msgspec.convert({**table, "at_s": 1e-6 * t_us}, Fault)
        except msgspec.ValidationError as error:
            raise ViewError(f"fault: {error}") from error
        self._vehicle.begin_fault(fault)
        which = (str(table[name]) for name in ("thruster", "looks") if name in table)
        return " ".join((f"Fault {fault.__struct_config__.tag}", *which))

    def _faults(self) -> tuple[FaultOffer, ...]:
        """Faults that this vehicle and simulation can have."""
        offers = [
            ("Camera or tracking silent for 10 s", {"kind": "camera_blackout", "duration_s": 10.0}),
            ("Shove to the north, 20 N for 2 s", _shove(20.0, 0.0)),
            ("Shove to the east, 20 N for 2 s", _shove(0.0, 20.0)),
            ("Caught on something for 20 s", {"kind": "snag", "duration_s": 20.0}),
            ("Battery down to 15 %", {"kind": "battery_sag", "remaining": 0.15}),
        ]
        if self._vehicle.pictured:
            offers += [
                (f"Pictures {appearance} for 10 s", {"kind": "camera_picture", "duration_s": 10.0, "looks": appearance})
                for appearance in ("black", "white", "fog", "frozen")
            ]
        if self._scenario.sensors.hull.enabled:
            offers.append(("Leak", {"kind": "leak"}))
        for thruster in self._vehicle.thrusters:
            offers.append((f"Thruster {thruster} lost", {"kind": "thruster_loss", "thruster": thruster}))
        return tuple(FaultOffer(label=label, fault=fault) for label, fault in offers)


def _shove(north_n: float, east_n: float) -> dict[str, object]:
    return {"kind": "shove", "duration_s": 2.0, "force_ned_n": [north_n, east_n, 0.0]}
