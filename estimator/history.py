"""The last second of the filter, for updates with late measurements at their time of validity."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from autopilot.core.frames import FloatArray
from autopilot.core.sensors import AID_SENSORS
from autopilot.estimator.carry import Correction, PastUpdate
from autopilot.estimator.filter_core import FilterCore, Innovation
from autopilot.estimator.inertial import Inertial, InertialStep
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.states import FilterState

SPAN_US = 1_000_000
"""Largest age of a measurement; older ones are dropped and counted."""


class Reopening(NamedTuple):
    """Reset of a sensor: the variance of these states is increased just before its next measurement."""

    sensor: str
    t_us: int
    part: slice
    variance: float
    value: tuple[float, ...] | None = None
    """What they are from then on, None = as they were."""

    def applied(self, core: FilterCore, state: FilterState) -> FilterState:
        return core.reopen(state, self.part, self.variance, self.value)


class Loosening(NamedTuple):
    """A sheet of the map does not lie where it was estimated to: it may have moved by any amount of this variance."""

    sensor: str
    t_us: int
    sheet: int
    sigma: tuple[float, ...]
    """(4,) how well it was laid,"""
    variance: tuple[float, ...]
    """(4,) and what comes on top."""

    def applied(self, core: FilterCore, state: FilterState) -> FilterState:
        return core.loosen(state, self.sheet, self.sigma, self.variance)


Change: TypeAlias = Measurement | Reopening | Loosening
"""What happens to the state at a node."""


@dataclass(slots=True, eq=False)
class Node:
    """One moment on the AHRS's time axis."""

    t_us: int
    moment: Moment
    step: InertialStep | None
    """How it came here from the node before, None for the first."""
    state: FilterState
    """After the measurements of this node."""
    prior: FilterState | None = None
    """Before them; None for the first node, which takes them in the order of their arrival."""
    used: list[Change] = field(default_factory=list)
    """What has been used here, in the order of :func:`_rank`."""
    updates: list[PastUpdate | None] = field(default_factory=list)
    """The updates that it made."""
    transition: FloatArray | None = None
    """Jacobian (21, 21) of the step."""
    pending: list[Correction] = field(default_factory=list)
    """What late measurements of earlier nodes change in :attr:`state`, and it does not hold yet."""


class History:
    """Nodes of the last second, oldest first. Changes of a node are carried to later ones when these are asked for."""

    def __init__(self, core: FilterCore, first: Node) -> None:
        self._core = core
        self._nodes: deque[Node] = deque([first])
        self._changed: Node | None = None
        """The oldest node whose change the nodes after it do not know yet,"""
        self._correction: Correction | None = None
        """and that change; None = it can only be computed again."""

    @property
    def newest(self) -> Node:
        node = self._nodes[-1]
        if self._changed is not None or node.pending:
            self._settle(node)
        return node

    def append(self, t_us: int, moment: Moment, step: InertialStep) -> Node:
        state = self._core.predict(self.newest.state, step)
        node = Node(t_us, moment, step, state, state, transition=self._core.transition())
        self._nodes.append(node)
        while self._nodes[0].t_us < t_us - SPAN_US:
            self._nodes.popleft()
        return node

    def at(self, t_us: int) -> Node | None:
        """The last node at or before that time; None if that is too old."""
        for node in reversed(self._nodes):
            if node.t_us <= t_us:
                self._settle(node)
                return node
        return None

    def correct(self, node: Node, measurement: Measurement, innovation: Innovation) -> None:
        if self._place(node, measurement, innovation.update):
            node.state = self._core.correct(node.state, innovation)
            node.updates.append(innovation.update)

    def forget(self, node: Node, change: Reopening | Loosening) -> None:
        """Know less of some states or of a sheet at ``node``."""
        if self._place(node, change):
            node.state = change.applied(self._core, node.state)
            node.updates.append(None)

    def _settle(self, until: Node) -> None:
        """Propagate a changed node to those after it, up to and including ``until``: carry the correction forward, or
        recompute them with their measurements. Later nodes are left until they are needed, as the same tick may change
        them again.
        """
        changed = self._changed
        if changed is not None and until.t_us > changed.t_us:
            later = []
            for other in reversed(self._nodes):
                if other is changed:
                    break
                if other.t_us <= until.t_us:
                    later.append(other)
            later.reverse()
            correction = self._correction
            if correction is not None and all(None not in other.updates for other in later):
                self._correction = _carried(correction, later)
            else:
                self._correction = None
                self._compute(changed, later)
            self._changed = None if until is self._nodes[-1] else until
        if until.pending:
            for correction in until.pending:
                until.state = correction.on(until.state)
            until.pending.clear()

    def _compute(self, before: Node, nodes: list[Node]) -> None:
        """Predict and correct these nodes after ``before`` again."""
        for node in nodes:
            assert node.step is not None
            node.pending.clear()
            node.prior = self._core.predict(before.state, node.step)
            node.transition = self._core.transition()
            node.state = self._corrected(node, node.prior)
            before = node

    def redrive(
        self, from_us: int, drive: Callable[[Node, Inertial], tuple[Inertial, InertialStep]], without: str
    ) -> None:
        """Compute the nodes after ``from_us`` again with other steps, and without the measurements of one sensor.

        ``drive`` gives the inertial moment of a node and the step to it from the node before."""
        self._settle(self._nodes[-1])
        before: Node | None = None
        for node in self._nodes:
            if before is not None and node.t_us > from_us:
                self._settle(before)
                inertial, node.step = drive(before, node.moment.inertial)
                node.moment = node.moment._replace(inertial=inertial)
                node.used = [item for item in node.used if item.sensor != without]
                self._compute(before, [node])
            before = node

    def _place(self, node: Node, new: Change, update: PastUpdate | None = None) -> bool:
        """Insert a measurement into those of the node. True if it is the last; otherwise the node has been recomputed.

        The order does not depend on the arrival times, and neither does the result.
        """
        self._settle(node)
        place = len(node.used)
        if place and node.prior is not None:
            rank = _rank(new)
            while place and _rank(node.used[place - 1]) > rank:
                place -= 1
        last = place == len(node.used)
        if node is not self._nodes[-1]:
            carried = None if update is None or not last else Correction(update.gain, update.spread, update.y)
            self._note(node, carried)
        node.used.insert(place, new)
        if last:
            return True
        before = self._before(node)
        if before is None:  # the first one that is left
            assert node.prior is not None
            node.state = self._corrected(node, node.prior)
        else:
            self._compute(before, [node])
        return False

    def _note(self, node: Node, correction: Correction | None) -> None:
        """A node changes that has been settled: by a correction that can be carried on, or None."""
        if self._changed is None:
            self._changed, self._correction = node, correction
        elif self._changed is node and self._correction is not None and correction is not None:
            self._correction = self._correction.joined(correction)
        else:
            self._changed, self._correction = node, None
        if self._correction is not None and not self._correction.small:
            self._correction = None

    def _before(self, node: Node) -> Node | None:
        before = None
        for other in self._nodes:
            if other is node:
                break
            before = other
        if before is not None:
            self._settle(before)
        return before

    def _corrected(self, node: Node, state: FilterState) -> FilterState:
        node.updates = []
        for item in node.used:
            update = None
            if isinstance(item, Reopening | Loosening):
                state = item.applied(self._core, state)
            else:
                innovation = self._core.innovation(state, item, node.moment, 1e-6 * (item.t_us - node.t_us))
                state, update = self._core.correct(state, innovation), innovation.update
            node.updates.append(update)
        return state


def _carried(correction: Correction, nodes: list[Node]) -> Correction:
    """The correction at the last of these nodes."""
    for node in nodes:
        assert node.transition is not None
        correction = Correction(node.transition.dot(correction.w), correction.c, correction.e)
        for i, update in enumerate(node.updates):
            assert update is not None
            correction, node.updates[i] = correction.through(update)
        node.pending.append(correction)
    return correction


_ORDER = {name: number for number, name in enumerate(AID_SENSORS)}


def _rank(item: Change) -> tuple[int, int]:
    return item.t_us, _ORDER.get(item.sensor, len(_ORDER))
