"""The shipped controller that breaks at a time: faults that no scenario file can make.

A scenario names them as anybody's controller (``package:Class``); the flight sets :attr:`Breaking.from_s` before.
"""

import math
from typing import Any

from autopilot.control.controller import MotionController
from autopilot.control.protocol import ControllerContext
from autopilot.core.messages import ControlOutput


class Breaking(MotionController):
    """Flies as shipped until ``from_s``."""

    from_s = math.inf
    """Of the service's clock; of all instances."""

    def __init__(self, given: ControllerContext) -> None:
        super().__init__(given.vehicle, currents=given.currents, desks=given.desks, trajectories=given.trajectories)

    def step(self, t_us: int, *given: Any, **named: Any) -> ControlOutput:
        """See :class:`autopilot.control.protocol.Controller`."""
        if t_us >= Breaking.from_s * 1e6:
            self._break()
        return super().step(t_us, *given, **named)

    def _break(self) -> None:
        raise NotImplementedError


class Unsolved(Breaking):
    """From then on no program of the optimiser is solved: the whole chain behind it has to fly."""

    def _break(self) -> None:
        solver_step = self.nmpc._step

        def nothing() -> None:
            solver_step.figures[:] = math.nan

        setattr(solver_step, "evaluate", nothing)  # noqa: B010 - a method of another's object


class Raising(Breaking):
    """Raises once."""

    raised = False

    def _break(self) -> None:
        if not self.raised:
            self.raised = True
            raise RuntimeError("controller broken by the campaign")
