"""Aiding source of positions. Its reset moves the whole filter and therefore needs more evidence than that of others.

Rejected fixes are monitored (:mod:`.estimator.relocation`): mutually consistent ones may move the filter. Whether the
source is used at all depends on the motion of its fixes (:mod:`.estimator.fix_trust`).
"""

from abc import ABC, abstractmethod
from typing import Generic

from autopilot.estimator.aiding import Aid, S_contra
from autopilot.estimator.fix_trust import FixTrust
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.relocation import Relocation


class FixAid(Aid, ABC, Generic[S_contra]):
    def __init__(self, time_offset_s: float = 0.0) -> None:
        super().__init__(time_offset_s)
        self.relocation, self.trust = Relocation(), FixTrust()
        self.jumped = False
        """The source has said that its pose has jumped, and none of its poses has been used since."""

    @abstractmethod
    def first_fix(self, sample: S_contra, inertial: Inertial) -> PoseFix | None:
        """A pose from a sample before initialisation; None if this sample gives none."""
        ...

    @abstractmethod
    def fix(self, sample: S_contra, node: Node) -> PoseFix | None:
        """A pose from a sample that belongs to ``node``; None if this sample gives none."""
        ...
