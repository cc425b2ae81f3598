"""State machine of arming and flight modes."""

from collections.abc import Callable
from typing import TypeVar

from autopilot.command.decision import Pose
from autopilot.command.failsafe_table import Effect
from autopilot.command.failsafes import FailsafeRules
from autopilot.command.modes.mode import FlightModeBehaviour, ModeContext, ModeStep, denied, no_position
from autopilot.command.modes.mode_table import MODES
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.control.thrust.by_hand import ByHand
from autopilot.core import operator_messages as notices
from autopilot.core.messages import Authority, Failsafe, FlightControllerState, Goal, NavState
from autopilot.mavlink.api import CommandReply, FlightMode
from autopilot.mission.items import Order

M = TypeVar("M", bound=FlightModeBehaviour)


class ModeMachine:
    """Executes orders that :mod:`autopilot.command.commander` has checked."""

    def __init__(self, tools: ModeContext, failsafes: FailsafeRules) -> None:
        self._goals = tools.goals
        self._mission = tools.mission
        self._operator = tools.operator
        self._modes = {kind.name: kind(tools) for kind in MODES}
        self._failsafes = failsafes
        self._seen = True
        """Whether there was a position on the last tick."""
        self._under_way = False
        self._override: FlightMode | None = None
        self.status: VehicleStatus | None = None
        """Of the last tick, None before the first one."""
        self.armed = False
        self.yielded = False
        """The pilot of the flight controller below has the vehicle: nothing is commanded."""
        self._before = FlightMode.HOLD
        """The mode when he took it."""
        self.chosen = FlightMode.HOLD
        """The operator's mode."""
        self.goal: Goal | None = None
        """Goal of the mode in force, None before its first step."""
        self.drop_weight = False
        """A failsafe has let the drop weight go, since the last arming."""
        self.disarms_flight_controller = False
        """A disarming of ours is to reach the flight controller below; taken by the commander."""
        self.handed_back = False
        """A failsafe has given the thrusters to the flight controller below, since the last arming."""
        self.ascent: Pose | None = None
        """Position at which to surface when the controller finds no solution, None = the controller flies."""
        self.equipment_orders: list[Order] = []
        """Of mission items passed, for what the vehicle carries; taken once per tick."""
        self.orders = 0
        """Incremented by every new order."""

    @property
    def mode(self) -> FlightMode:
        """The mode in force: the operator's, or the one that a failsafe put over it."""
        return self.chosen if self._override is None else self._override

    @property
    def overridden(self) -> bool:
        """Whether a failsafe has put its mode over the operator's."""
        return self._override is not None

    @property
    def under_way(self) -> bool:
        """Whether a mode other than hold, or a go-to, has been entered since arming (reported as "flying")."""
        return self.armed and self._under_way

    @property
    def nav(self) -> NavState | None:
        """Estimate of the last tick, None if it is missing or lost."""
        return None if self.status is None else self.status.estimate

    @property
    def active(self) -> FlightModeBehaviour:
        return self._modes[self.mode]

    def of_kind(self, kind: type[M]) -> M:
        mode = self._modes[kind.name]
        assert isinstance(mode, kind)
        return mode

    def refusal(self, mode: FlightMode) -> CommandReply | None:
        """Why a mode is not entered, None if it can be."""
        if self.yielded:
            return denied("Denied: the pilot has the vehicle below us")
        steers = not self._modes[mode].needs_position and not self._failsafes.acts_beside(Failsafe.NAV_LOST)
        if self.overridden and mode is not FlightMode.SURFACE and self._failsafes.acting and not steers:
            return denied(f"Mode change denied: failsafe active ({self._failsafes.describe()})")
        piloted = self.armed and not self.active.needs_position
        if piloted and self.nav is None and self._modes[mode].needs_position and mode is not FlightMode.SURFACE:
            return no_position(mode)  # the pilot would let go of a vehicle that drifts
        return self._modes[mode].refusal(self.status, armed=self.armed)

    def prepare(self, mode: FlightMode) -> str:
        """Prepare a mode selected without arguments. Returns the reason of a refusal, else ""."""
        return self._modes[mode].prepare(self.nav, armed=self.armed)

    # Orders

    def arm(self) -> None:
        """Arm and set home here. The caller enters the mode."""
        self.armed, self.disarms_flight_controller = True, False
        self.drop_weight = self.handed_back = False
        self._failsafes.clear()
        self._mission.sequencer.repeat_orders()
        if self.nav is not None:
            self._mission.move_home(self.nav.pos_ned_m)
        self._under_way = False

    def disarm(self, *, force: bool) -> None:
        """Thrusters stand; the next arming begins in HOLD."""
        if not self.armed:
            return
        self.armed = self.yielded = False
        self.disarms_flight_controller = True
        self._override = None
        self.enter(FlightMode.HOLD)
        self._operator.say(notices.EMERGENCY_STOP() if force else notices.DISARMED())

    def choose(self, mode: FlightMode) -> None:
        """The operator's order. It ends a failsafe's override, but for one that surfaces already."""
        if mode is not self.chosen:
            self._operator.say(notices.MODE(name=mode.name))
        if self._override is not None and mode is not FlightMode.SURFACE:
            self._override = None
            self._failsafes.clear()
        elif self._override is not None:
            self._override = FlightMode.SURFACE
        self.enter(mode)

    def enter(self, mode: FlightMode) -> None:
        self.orders += 1
        self.ascent = None
        self._under_way |= mode is not FlightMode.HOLD
        if mode is not self.chosen:
            self._modes[self.chosen].leave()
        self._modes[mode].enter(self.nav)
        self.goal = self._goal_here(mode)
        self.chosen = mode

    def fly_to(self, goal: Goal) -> None:
        self.goal = goal
        self._under_way = True

    def interrupt(self) -> None:
        """Stop the mission and hold. A failsafe action continues."""
        if self._override is None:
            self.enter(FlightMode.HOLD)
        self.chosen = FlightMode.HOLD

    def fall_back(self) -> None:
        """Hold until the next order. A failsafe action continues."""
        if self.armed and self._override is None:
            self.enter(FlightMode.HOLD)

    # The flight controller below

    def watch_flight_controller(self, below: FlightControllerState | None, may_resume: Callable[[], bool]) -> None:
        """Let go when its pilot takes the vehicle, take it back when he gives it back, and stop when it has stopped."""
        if below is None or not self.armed:
            return
        if below.authority is Authority.STOPPED:
            self._operator.say(notices.FLIGHT_CONTROLLER_DISARMED(reason=below.text))
            self.disarm(force=True)
            self.disarms_flight_controller = False
        elif below.authority is Authority.PILOT and not self.yielded:
            self._before = self.chosen
            self.enter(FlightMode.HOLD)
            self.yielded, self.goal = True, None
            self._operator.say(notices.PILOT_HAS_CONTROL(mode=below.text))
        elif below.authority is Authority.OURS and self.yielded:
            self.yielded = False
            if not self._failsafes.acting:
                self._override = None
                self._failsafes.clear()
            resumes = self._before is FlightMode.MISSION and self._override is None and may_resume()
            self._operator.say(notices.PILOT_GAVE_BACK(next="mission resumes" if resumes else "holding"))
            self.enter(FlightMode.MISSION if resumes else FlightMode.HOLD)

    # One tick

    def apply_failsafes(self, status: VehicleStatus) -> None:
        """Act on the failsafe conditions of this tick."""
        for event in self._failsafes.update(status, armed=self.armed):
            self._operator.pass_on(event)
        action = self._failsafes.action
        if not self.armed or self.yielded or action is None:
            return
        if action == "disarm" or action == "hand back":
            verb = "disarms" if action == "disarm" else "hands back"
            self._operator.say(notices.FAILSAFE_ENDS_FLIGHT(verb=verb, conditions=self._failsafes.describe()))
            self.handed_back = action == "hand back"
            self.disarm(force=True)
            self.disarms_flight_controller = not self.handed_back
            return
        if action == "drop" and not self.drop_weight:
            self.drop_weight = True
            self._operator.say(notices.FAILSAFE_DROPS(conditions=self._failsafes.describe()))
        mode = self._mode_of(action)
        if self._override is not mode and self._override is not FlightMode.SURFACE:
            self.active.leave()
            self._override = mode
            self.goal = self._goal_here(mode)
            self._operator.say(notices.FAILSAFE_MODE(mode=mode.name, conditions=self._failsafes.describe()))
        unsolved = self._failsafes.bits >> Failsafe.SOLVER & 1
        if self._override is FlightMode.SURFACE and unsolved and self.ascent is None and self.nav is not None:
            x, y, z = self._goals.surface(self.nav).pos_ned_m.tolist()
            self.ascent = (x, y, z, float(self.nav.rpy_rad[2]))

    def _mode_of(self, action: Effect) -> FlightMode:
        """Mode of a failsafe action. An action under way continues: return becomes hold if home is lost."""
        if action == "hold":
            return FlightMode.HOLD
        if action != "return":
            return FlightMode.SURFACE
        back = self._override is FlightMode.RETURN or not self._goals.refuse_home()
        return FlightMode.RETURN if back else FlightMode.HOLD

    def advance(self, status: VehicleStatus) -> tuple[Goal | None, tuple[int, ...]]:
        """Goal of this tick, and the mission items that have been reached on it."""
        nav = self.nav
        self._watch_position()
        self._mission.tell(status.t_us)
        if not self.armed or self.yielded or nav is None:
            return None, ()
        step = self.active.step(status, nav)
        self._follow(step)
        if self.goal is None:
            self.goal = self.active.place(nav)
        goal, end = self.goal, self.active.watch(status, self.goal, nav)
        self._follow(end)
        if self.armed:
            goal = self.goal
        return goal if self.ascent is None else None, step.reached

    def _follow(self, step: ModeStep) -> None:
        self.equipment_orders += step.orders
        if step.goal is not None:
            self.goal = step.goal
        if step.choose is not None:
            self.choose(step.choose)
        elif step.enter is not None:
            self.enter(step.enter)
        elif step.settle:
            self.chosen = FlightMode.HOLD
        elif step.disarm:
            self.disarm(force=False)

    def by_hand(self, status: VehicleStatus) -> ByHand | None:
        """Pilot command without a position, None where the mode needs one or there is one."""
        if not self.armed or self.yielded or self.nav is not None:
            return None
        return self.active.by_hand(status)

    def _watch_position(self) -> None:
        """Report to the pilot when fence and limits stop being enforced, and when they are enforced again."""
        seen, piloted = self.nav is not None, self.armed and not self.active.needs_position
        if piloted and self._seen and not seen:
            self._operator.say(notices.POSITION_LOST_PILOTED())
        elif piloted and seen and not self._seen:
            self._operator.say(notices.POSITION_BACK_PILOTED())
        if seen != self._seen:
            self.active.position_came_or_went()
        self._seen = seen

    def _goal_here(self, mode: FlightMode) -> Goal | None:
        return None if self.nav is None else self._modes[mode].place(self.nav)
