"""Fly a simulated vehicle from a program: whole missions (:func:`fly`) or step by step (:class:`Simulation`).

Between program and plant is the whole service, as ``autopilot sitl`` runs it: the estimator knows what sensors tell it,
failsafes and fence act, the thrusters get pulses. Time is that of the simulation; the same calls give the same results.
"""

import math
import shutil
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, Unpack, cast

import numpy as np

from autopilot.api.arrays import finite, thrust_limit_n
from autopilot.api.settings import FlightOptions, checked_seed, settings_of
from autopilot.control.protocol import STEP_S, Controller, simple_output
from autopilot.core.clock import TICK_US
from autopilot.core.errors import AutopilotError, ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import ControlOutput, Goal, NavState, Outputs, ProgressState
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.log.log_session import free_path
from autopilot.log.reader import Log, open_log
from autopilot.mavlink.api import FlightMode
from autopilot.run.config import system_id
from autopilot.run.sitl_console import RunWatch
from autopilot.run.sitl_params import sitl_params
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.operator import ARM, Order, ScriptedOperator
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario import load_scenario

STEP_TICKS = round(STEP_S * 1e6) // TICK_US

ARMED_WITHIN_S = 60.0
"""Simulated time in which a vehicle has to be armed: poses are there after two seconds, pictures after five."""

FARTHEST_M = 1e7
"""A goal is nearer: from a pole to the equator."""

SETTLED_S = 3.0
"""A flight goes on for so long after its mission is complete."""
OFFBOARD: Order = (176, (1.0, 6.0))
"""MAV_CMD_DO_SET_MODE, PX4's main mode 6: follow set points (mode GUIDED)."""

PERIOD_US = 100_000
"""Set points are repeated: without them mode GUIDED ends after OFFB_TIMEOUT."""

IGNORED = 0b1001_1111_1000
"""POSITION_TARGET_TYPEMASK: position and yaw count; velocities, accelerations and yaw rate do not."""
NO_YAW = 1 << 10

LOCAL_NED = 1
"""MAV_FRAME"""


class SetPointClient(ScriptedOperator):
    """Sends its goal as SET_POSITION_TARGET_LOCAL_NED while it has one."""

    def __init__(self, *, arms: bool) -> None:
        """``arms``: else another client does."""
        super().__init__(1, orders=(ARM,) if arms else ())
        self._goal: tuple[float, float, float, float] | None = None
        self._sent_goal_us = -PERIOD_US
        self._asked = False

    def go_to(self, goal: tuple[float, float, float, float], *, guided: bool) -> None:
        """North, east, depth [m], yaw [rad] (NaN = free), from the next tick on. ``guided``: the mode is GUIDED."""
        self._asked = guided  # a refused set point or a failsafe has ended it, or it has not begun
        if goal != self._goal:
            self._goal, self._sent_goal_us = goal, -PERIOD_US

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        if self._goal is None:
            return super().step(t_us, received)
        out: list[bytes] = []
        if t_us - self._sent_goal_us >= PERIOD_US:
            self._sent_goal_us = t_us
            north_m, east_m, depth_m, yaw_rad = self._goal
            free = math.isnan(yaw_rad)
            place = (north_m, east_m, depth_m, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if free else yaw_rad, 0.0)
            mask = IGNORED | (NO_YAW if free else 0)
            target = self._mav.set_position_target_local_ned_encode(0, self.target_system, 1, LOCAL_NED, mask, *place)
            out.append(self._pack(target))
        if not self._asked and self.started:
            self._asked = True
            self._todo.append(OFFBOARD)
        return out + super().step(t_us, received)


class Stepped:
    """A program may give the thrust of a step; everything else is the ``own`` controller's."""

    def __init__(self, own: Controller) -> None:
        self._own = own
        self.thrust_n: FloatArray | None = None
        """(N,) [N] from the next step on, None = the own controller's."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._own, name)

    def step(self, t_us: int, nav: NavState, *situation: Any, delay_s: float | None) -> ControlOutput:
        if self.thrust_n is not None:
            return simple_output(t_us, nav, self.thrust_n)
        return self._own.step(t_us, nav, *situation, delay_s=delay_s)

    def tick(self, t_us: int, nav: NavState) -> FloatArray | None:
        return None if self.thrust_n is not None else self._own.tick(t_us, nav)

    @property
    def unreachable(self) -> bool:
        return self.thrust_n is None and self._own.unreachable

    @property
    def shortfall(self) -> str:
        return "" if self.thrust_n is not None else self._own.shortfall


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StepInfo:
    """What a step has shown beside the estimate."""

    t_s: float
    """Since the start of the simulation [s]."""
    truth: Truth
    """The plant's true state: for rewards and plots, a vehicle does not have it."""
    thrust_n: FloatArray
    """(N,) commanded thrust of the last tick [N]."""
    goal: Goal | None
    """What the service is going to."""
    armed: bool
    mode: str
    mission: ProgressState
    contacts: int
    """Contacts with walls, floor and obstacles so far."""
    energy_j: float
    """Since the start of the simulation, electrical, everything [J]."""
    events: tuple[str, ...]
    """Messages to the operator during this step."""

    @property
    def over(self) -> bool:
        """Nothing more will happen: disarmed, or the mission is complete."""
        return not self.armed or self.mission is ProgressState.COMPLETE


class Simulation:
    """A simulated vehicle in steps of 50 ms.

    Parameters
    ----------
    scenario
        Name of a shipped scenario, or a file.
    start
        Whether its mission is started; else it holds where it was armed.
    log
        File to record in; a second :meth:`reset` writes a file with a number. None = no log.
    options
        See :class:`autopilot.api.settings.FlightOptions`.

    Raises
    ------
    ConfigError, PlanError
        The message names what cannot be. A class that cannot be made is found at :meth:`reset`.
    """

    def __init__(
        self,
        scenario: str | Path = "paper-tank",
        *,
        start: bool = False,
        log: str | Path | None = None,
        **options: Unpack[FlightOptions],
    ) -> None:
        self._start = start
        self._log = None if log is None else Path(log)
        folder = tempfile.mkdtemp(prefix="simulation-")
        self._clean = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self._settings, self._params = settings_of(scenario, Path(folder), options, start=start or None)
        self.vehicle, self.thrust_limit_n = self._actuators()
        """The vehicle file (names and order of the thrusters, masses, drag), and (N,) the largest thrust that is
        commanded, either way [N]."""
        self._session: SitlSession | None = None
        self._nav: NavState | None = None
        self._client: SetPointClient | None = None
        self._tick = 0
        self._outputs: list[Outputs] = []
        self.log_path: Path | None = None
        """Log of the flight since the last :meth:`reset`; whole after :meth:`close`."""

    # Flying

    def reset(self, seed: int | None = None) -> NavState:
        """Begin anew and arm.

        Parameters
        ----------
        seed
            Of noise and faults; None = the scenario's.

        Returns
        -------
        NavState
            The estimate, 10 ms before the controller's next step.

        Raises
        ------
        ConfigError
            The seed is no whole number from 0 on.
        AutopilotError
            It cannot be armed; the message has the reason.
        """
        seed = checked_seed(seed)
        self._end()
        self._settings.put("seed", seed, "reset(seed)")
        if self._log is not None:
            self.log_path = free_path(self._log)
            self._settings.put("log", str(self.log_path), "Simulation(log)")
        client = self._client = SetPointClient(arms=not self._start)
        session = self._session = open_sitl(
            self._settings,
            self._params,
            peers=(client,),
            log=self._log is not None,
            on_tick=self._outputs.append,
            around=lambda own: cast(Controller, Stepped(own)),
        )
        client.target_system = system_id(session.world.params, 0)
        self._tick, self._nav = 0, None
        return self._until_armed(session)

    def step(
        self, thrust_n: Sequence[float] | FloatArray | None = None, *, goal: Sequence[float] | FloatArray | None = None
    ) -> tuple[NavState, StepInfo]:
        """50 ms: one step of the controller. Without arguments the vehicle goes on with what it does.

        Parameters
        ----------
        thrust_n
            (N,) thrust of every thruster in the order of the vehicle file [N], for this step, instead of the
            controller's; cut to what the thrusters can and how fast they may change it.
        goal
            (3,) or (4,) north, east, depth [m] and yaw [rad] (left out or NaN = free) to go to from now on, in mode
            GUIDED by set points, with the controller that was chosen. It holds until the next one. One beyond the
            fence or the depths that are allowed changes nothing: ``info.events`` say why, and ``info.goal`` stays.

        Returns
        -------
        NavState, StepInfo
            The estimate at the end of the step, and everything else.

        Raises
        ------
        ConfigError
            Thrust or goal of another shape, not finite, or beyond any place.
        AutopilotError
            There has been no :meth:`reset`.
        """
        session = self._open()
        stepped: object = session.parts.controller
        assert isinstance(stepped, Stepped) and self._client is not None
        if goal is not None:
            self._client.go_to(_goal(goal), guided=session.parts.commander.mode is FlightMode.GUIDED)
        stepped.thrust_n = None if thrust_n is None else finite("thrust_n", thrust_n, len(self.vehicle.thrusters))
        nav, info = self._go_on(session, STEP_TICKS)
        assert nav is not None, "there is one from arming on"
        return nav, info

    def close(self) -> None:
        """End the flight, with its log whole."""
        self._end()
        self._clean()

    # Inside

    def _actuators(self) -> tuple[Vehicle, FloatArray]:
        """The vehicle file, and (N,) what is commanded of its thrusters at most."""
        scenario = load_scenario(self._settings["scenario"])
        vehicle = load_vehicle(self._settings["vehicle"] or scenario.vehicle.model)
        params, _, _ = sitl_params(self._settings, scenario, self._params, 0)
        return vehicle, thrust_limit_n(vehicle, params)

    def _open(self) -> SitlSession:
        if self._session is None:
            raise AutopilotError("the simulation has not begun, or is closed; call reset() first")
        return self._session

    def _end(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.close()

    def _until_armed(self, session: SitlSession) -> NavState:
        """Tick until the vehicle is armed and a step of the controller is due."""
        said: list[str] = []
        while self._tick * TICK_US < ARMED_WITHIN_S * 1e6:
            _, info = self._go_on(session, 1)
            said += info.events
            if info.armed and self._outputs[-1].control is not None:
                nav, _ = self._go_on(session, STEP_TICKS - 1)
                assert nav is not None, "the controller ran on it"
                return nav
        self._end()
        reasons = "; ".join(dict.fromkeys(said[-3:])) or "no reason was given"
        raise AutopilotError(f"not armed within {ARMED_WITHIN_S:.0f} s: {reasons}")

    def _go_on(self, session: SitlSession, ticks: int) -> tuple[NavState | None, StepInfo]:
        self._outputs.clear()
        for _ in range(ticks):
            self._tick += 1
            session.runtime.tick(self._tick * TICK_US)
        last, truth = self._outputs[-1], session.device.truth
        info = StepInfo(
            t_s=1e-6 * last.t_us,
            truth=truth,
            thrust_n=last.command.thrust_n[: len(self.vehicle.thrusters)].copy(),
            goal=last.goal,
            armed=last.mode.armed,
            mode=session.parts.commander.mode.name,
            mission=ProgressState.NO_MISSION if last.progress is None else last.progress.state,
            contacts=truth.contact_count,
            energy_j=truth.energy_used_j,
            events=tuple(event.text for outputs in self._outputs for event in outputs.events),
        )
        self._nav = self._nav if last.nav is None else last.nav
        return self._nav, info

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _goal(given: Sequence[float] | FloatArray) -> tuple[float, float, float, float]:
    try:
        values = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"goal={given!r} is no array of numbers ({error})") from error
    yaw_rad = values.item(3) if values.shape == (4,) else math.nan
    north_m, east_m, depth_m = finite("goal", values[:3] if values.shape == (4,) else values, 3).tolist()
    if max(abs(north_m), abs(east_m), abs(depth_m)) > FARTHEST_M or abs(yaw_rad) > FARTHEST_M:
        raise ConfigError(f"goal={given!r} is beyond any place; use metres, and radians or NaN for yaw")
    return north_m, east_m, depth_m, yaw_rad


def fly(
    scenario: str | Path = "paper-tank",
    *,
    seed: int | None = None,
    duration_s: float | None = None,
    log: str | Path | None = None,
    **options: Unpack[FlightOptions],
) -> Log:
    """Fly a scenario's mission, as fast as the machine allows.

    Parameters
    ----------
    scenario
        Name of a shipped scenario, or a file.
    seed
        Of noise and faults; None = the scenario's.
    duration_s
        At most so long [s]; None = the scenario's.
    log
        File to record in; None = one that is deleted with the last reference to the result.
    options
        See :class:`autopilot.api.settings.FlightOptions`.

    Returns
    -------
    Log
        The flight, open for reading: ``log["/nav/state"]["pos_ned_m"]`` (docs/log.md).

    Raises
    ------
    AutopilotError
        It cannot be flown or recorded; the message says why. A mission that ends otherwise than it should is no
        error: ``log`` tells of it.
    """
    folder = tempfile.mkdtemp(prefix="flight-")
    path = Path(folder) / "run.mcap" if log is None else Path(log)
    try:
        given = {"start": True, "seed": seed, "duration": duration_s, "log": str(path)}
        settings, params = settings_of(scenario, Path(folder), options, **given)
        session = open_sitl(settings, params, on_tick=lambda outputs: watch.step(outputs))
        watch = RunWatch(session, lambda _: None)
        ended_us: list[int] = []

        def enough() -> bool:
            if watch.ended and not ended_us:
                ended_us.append(session.device.truth.t_us)
            return bool(ended_us) and session.device.truth.t_us >= ended_us[0] + SETTLED_S * 1e6

        session.run(enough)
        flown = open_log(path)
        weakref.finalize(flown, shutil.rmtree, folder, ignore_errors=True)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return flown
