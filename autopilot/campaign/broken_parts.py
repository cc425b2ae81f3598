"""Shipped controller and estimator that fail at a given time: faults that no scenario file can make.

A flight names them as plug-ins (``package:Class``), and sets :attr:`Breaking.from_s` before.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from autopilot.control.controller import MotionController
from autopilot.control.protocol import ControllerContext
from autopilot.core.frames import FloatArray
from autopilot.core.messages import ControlOutput, NavState
from autopilot.core.samples import Sample
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.kalman import KalmanCore
from autopilot.estimator.protocol import EstimatorContext


class Breaking(MotionController):
    """Flies as shipped until ``from_s``."""

    from_s = math.inf
    """Of the service's clock; of all instances."""

    def __init__(self, given: ControllerContext) -> None:
        super().__init__(given.vehicle, currents=given.currents, desks=given.desks, trajectories=given.trajectories)

    def step(self, t_us: int, *given: Any, **named: Any) -> ControlOutput:
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
    raised = False

    def _break(self) -> None:
        if not self.raised:
            self.raised = True
            raise RuntimeError("controller broken by the campaign")


class DisplacedEstimator(AidedEstimator):
    """The shipped filter, whose depth is off for some seconds."""

    LASTS_S = 4.0
    OFF_M = 0.25
    """Down: nothing to run into."""

    def __init__(self, given: EstimatorContext) -> None:
        core = KalmanCore(current_3d=given.options.current_3d)
        super().__init__(core, given.vehicle, given.markers, given.floor_depth_m, given.options)

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        nav = super().step(t_us, samples, thrust_n)
        since_s = 1e-6 * t_us - Breaking.from_s
        if nav is None or not 0.0 <= since_s < self.LASTS_S:
            return nav
        return replace(nav, pos_ned_m=nav.pos_ned_m + np.array([0.0, 0.0, self.OFF_M]))
