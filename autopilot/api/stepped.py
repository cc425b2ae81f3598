"""A controller whose thrust a program may give for a step; without, its own controller decides."""

from typing import Any

from autopilot.control.protocol import Controller, simple_output
from autopilot.core.frames import FloatArray
from autopilot.core.messages import ControlOutput, NavState


class Stepped:
    """Everything but a step with given thrust is the ``own`` controller's."""

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
