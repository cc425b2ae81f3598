"""Records the data that a run is judged by at 100 Hz: ground truth, command, estimation error."""

import math
from collections.abc import Callable

import numpy as np

from autopilot.campaign.tube_study import TubeCheck
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Event, Failsafe, Fallback, Outputs, ProgressState, Severity
from autopilot.log.analysis import Span, VehicleTrack
from autopilot.log.smoothness import ThrustCommands, is_reported
from autopilot.sitl.plant import Truth

COLUMNS = (
    *("t_s", "x", "y", "z", "roll", "pitch", "yaw", "u", "v", "w", "u_r", "v_r", "w_r", "p", "q", "r"),
    *("c_n", "c_e", "c_d", "thrust_n", "power_w", "e_x", "e_y", "e_z", "e_yaw", "e_cn", "e_ce"),
    *("s_x", "s_y", "s_z", "s_yaw"),
)
FIRST_ROWS = 8192
MOST_EVENTS = 12
"""Events that are kept."""
HOLD_S = 3.0
"""Time that is judged after the end of the mission or the disarming."""


class TickWatch:
    def __init__(self, truth: Callable[[], Truth]) -> None:
        self._truth = truth
        self._rows: FloatArray = np.full((FIRST_ROWS, len(COLUMNS)), np.nan)
        self._count = 0
        self._armed_s: float | None = None
        self._disarmed_s: float | None = None
        self._complete_s: float | None = None
        self.failsafes = 0
        """All bits set at any time while armed."""
        self.steps = 0
        self.fallbacks = 0
        self.slack_max = 0.0
        self.events: list[str] = []
        """Since arming."""
        self.not_armed = ""
        """The last warning before."""
        self._now_s = 0.0
        self.tube = TubeCheck()
        self._commands: list[tuple[float, Fallback, FloatArray]] = []
        self._starts_s: list[float] = []
        self._thrusters = 0
        self._reported_s: list[float] = []
        self._goal: tuple[float, ...] | None = None

    def tick(self, outputs: Outputs) -> None:
        t_s = outputs.t_us * 1e-6
        self._note_phase(outputs, t_s)
        if self._armed_s is None or self._disarmed_s is not None:
            return
        truth = self._truth()
        row = self._next_row()
        row[0] = t_s
        row[1:4] = truth.pos_ned_m
        row[4:7] = truth.rpy_rad
        row[7:10] = truth.vel_frd_m_s
        row[10:13] = truth.vel_water_frd_m_s
        row[13:16] = truth.rate_frd_rad_s
        row[16:19] = truth.current_ned_m_s
        row[19] = max(map(abs, outputs.command.thrust_n.tolist()))
        row[20] = truth.power_w
        nav = outputs.nav
        if nav is not None:
            row[21:24] = nav.pos_ned_m - truth.pos_ned_m
            row[24] = wrap_pi(float(nav.rpy_rad[2] - truth.rpy_rad[2]))
            row[25:27] = nav.current_ned_m_s[:2] - truth.current_ned_m_s[:2]
            row[27:31] = np.sqrt(nav.variance[[0, 1, 2, 5]])
        if self._complete_s is None:
            self.tube.update(t_s, float(row[1]), float(row[2]))
        self._note_control(outputs)

    @property
    def over(self) -> bool:
        ends = [end for end in (self._complete_s, self._disarmed_s) if end is not None]
        return bool(ends) and self._now_s >= min(ends) + HOLD_S

    @property
    def completed(self) -> bool:
        return self._complete_s is not None

    @property
    def armed(self) -> Span:
        """From arming to disarming or the end."""
        return Span(self._armed_s or 0.0, math.inf)

    @property
    def mission(self) -> Span:
        """From arming to the completion of the mission."""
        return Span(self._armed_s or 0.0, math.inf if self._complete_s is None else self._complete_s)

    @property
    def rows(self) -> FloatArray:
        """(n, COLUMNS) of the time while armed."""
        return self._rows[: self._count]

    def column(self, name: str) -> FloatArray:
        """(n,)"""
        return self.rows[:, COLUMNS.index(name)]

    @property
    def track(self) -> VehicleTrack:
        """The truth as the analysis of logs takes it."""
        rows = self.rows
        return VehicleTrack(
            t_s=rows[:, 0],
            pos_ned_m=rows[:, 1:4],
            rpy_rad=rows[:, 4:7],
            vel_frd_m_s=rows[:, 7:10],
            vel_water_frd_m_s=rows[:, 10:13],
            rate_frd_rad_s=rows[:, 13:16],
            current_ned_m_s=rows[:, 16:19],
        )

    def commands(self, limit_n: float) -> ThrustCommands:
        """The commands of the control steps until the mission was complete; THR_LIMIT is ``limit_n``."""
        kept = [command for command in self._commands if self.mission.holds(np.array([command[0]]))[0]]
        return ThrustCommands(
            t_s=np.array([t_s for t_s, _, _ in kept]),
            thrust_n=np.array([thrust_n for _, _, thrust_n in kept]).reshape(len(kept), self._thrusters),
            fallback=np.array([fallback for _, fallback, _ in kept], dtype=np.uint8),
            starts_s=np.array([self._armed_s or 0.0, *self._starts_s]),
            reported_s=np.array(self._reported_s),
            limit_n=limit_n,
        )

    @property
    def failsafe_names(self) -> list[str]:
        """Failsafes that acted or warned while armed."""
        return [rule.name.lower() for rule in Failsafe if self.failsafes >> rule & 1]

    def _note_phase(self, outputs: Outputs, t_s: float) -> None:
        self._now_s = t_s
        armed = outputs.mode.armed
        if armed and self._armed_s is None:
            self._armed_s = t_s
        if self._armed_s is not None and self._disarmed_s is None:
            progress = outputs.progress  # also of the tick that disarms: a last item may be at the surface
            if progress is not None and progress.state is ProgressState.COMPLETE and self._complete_s is None:
                self._complete_s = t_s
            self._disarmed_s = None if armed else t_s
        if outputs.events:
            for event in outputs.events:
                self._note_event(event, t_s)
            self._reported_s += [t_s] * int(is_reported([event.text for event in outputs.events]).sum())

    def _note_event(self, event: Event, t_s: float) -> None:
        if event.severity > Severity.WARNING:
            return
        if self._armed_s is None:
            self.not_armed = event.text
        elif len(self.events) < MOST_EVENTS:
            self.events.append(f"{t_s:.2f} s {event.text}")

    def _note_control(self, outputs: Outputs) -> None:
        self.failsafes |= outputs.mode.failsafes
        if outputs.control is None:
            return
        if len(outputs.control.tube_m):
            self.tube.announce(outputs.control)
        status = outputs.control.status
        t_s, goal = outputs.t_us * 1e-6, outputs.goal
        place = None if goal is None else (*goal.pos_ned_m.tolist(), float(goal.seq))
        if place != self._goal:
            self._starts_s.append(t_s)
        self._goal = place
        self._thrusters = sum(map(bool, outputs.command.pwm_us))
        self._commands.append((t_s, status.fallback, outputs.command.thrust_n[: self._thrusters].copy()))
        self.steps += 1
        self.fallbacks += status.fallback is not Fallback.NONE
        if math.isfinite(status.slack_max):
            self.slack_max = max(self.slack_max, status.slack_max)

    def _next_row(self) -> FloatArray:
        if self._count == len(self._rows):
            self._rows = np.concatenate((self._rows, np.full_like(self._rows, np.nan)))
        self._count += 1
        row: FloatArray = self._rows[self._count - 1]
        return row
