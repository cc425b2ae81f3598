"""A controller whose thrust a program may give for a step; without, its own controller decides."""

from collections.abc import Sequence

from autopilot.control.protocol import Controller, simple_output
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import ControlOutput, Goal, NavState, Severity
from autopilot.core.params import ParamSet
from autopilot.core.samples import ObstacleTrack


class Stepped(Controller):
    """Everything but a step with given thrust is the ``own`` controller's."""

    def __init__(self, own: Controller) -> None:
        self._own = own
        self.thrust_n: FloatArray | None = None
        """(N,) [N] from the next step on, None = the own controller's."""

    def step(
        self,
        t_us: int,
        nav: NavState,
        goal: Goal,
        fence: Fence,
        params: ParamSet,
        thruster_limit_n: FloatArray,
        tracks: Sequence[ObstacleTrack],
        *,
        delay_s: float | None,
    ) -> ControlOutput:
        if self.thrust_n is not None:
            return simple_output(t_us, nav, self.thrust_n)
        return self._own.step(t_us, nav, goal, fence, params, thruster_limit_n, tracks, delay_s=delay_s)

    def tick(self, t_us: int, nav: NavState) -> FloatArray | None:
        return None if self.thrust_n is not None else self._own.tick(t_us, nav)

    def reset(self) -> None:
        self._own.reset()

    def warm(self, params: ParamSet) -> None:
        self._own.warm(params)

    def take_news(self) -> list[tuple[Severity, str]]:
        return self._own.take_news()

    @property
    def solver(self) -> str:
        return self._own.solver

    @property
    def unreachable(self) -> bool:
        return self.thrust_n is None and self._own.unreachable

    @property
    def shortfall(self) -> str:
        return "" if self.thrust_n is not None else self._own.shortfall

    def planar_speed_m_s(self, nav: NavState, params: ParamSet) -> float:
        return self._own.planar_speed_m_s(nav, params)

    def goal_margin_m(self, params: ParamSet) -> float:
        return self._own.goal_margin_m(params)

    def refusals(
        self, nav: NavState, goals: Sequence[tuple[str, float]], fence_half_m: float, params: ParamSet
    ) -> tuple[str, ...]:
        return self._own.refusals(nav, goals, fence_half_m, params)
