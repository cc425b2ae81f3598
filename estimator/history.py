"""The last second of the filter, kept so that a late measurement can be put where it belongs."""

from collections import deque
from dataclasses import dataclass, field

from estimator.core import FilterCore, Innovation
from estimator.inertial import Step
from estimator.measurement import Measurement, Moment
from estimator.states import FilterState

SPAN_US = 1_000_000
"""How far back a measurement may lie; older ones are dropped and counted."""


@dataclass(slots=True, eq=False)
class Node:
    """One moment on the AHRS's time axis."""

    t_us: int
    moment: Moment
    step: Step | None
    """How it came here from the node before, None for the first."""
    state: FilterState
    """After the measurements of this node."""
    measurements: list[Measurement] = field(default_factory=list)
    """What has been used here, in that order."""


class History:
    """Nodes of the last second, oldest first."""

    def __init__(self, core: FilterCore, first: Node) -> None:
        self._core = core
        self._nodes: deque[Node] = deque([first])

    @property
    def newest(self) -> Node:
        """The latest node."""
        return self._nodes[-1]

    def append(self, t_us: int, moment: Moment, step: Step) -> Node:
        """Predict from the newest node to a new one."""
        state = self._core.predict(self._nodes[-1].state, step)
        node = Node(t_us, moment, step, state)
        self._nodes.append(node)
        while self._nodes[0].t_us < t_us - SPAN_US:
            self._nodes.popleft()
        return node

    def at(self, t_us: int) -> Node | None:
        """The last node at or before that time; None if that is too old."""
        for node in reversed(self._nodes):
            if node.t_us <= t_us:
                return node
        return None

    def correct(self, node: Node, measurement: Measurement, innovation: Innovation) -> None:
        """Use a measurement at ``node``, without telling the later nodes: call :meth:`replay` when done."""
        node.state = self._core.correct(node.state, innovation)
        node.measurements.append(measurement)

    def replay(self, node: Node) -> None:
        """Compute all nodes after ``node`` again, with the measurements that they have."""
        later = []
        for other in reversed(self._nodes):
            if other is node:
                break
            later.append(other)
        state = node.state
        for other in reversed(later):
            assert other.step is not None
            state = self._core.predict(state, other.step)
            for measurement in other.measurements:
                after_s = 1e-6 * (measurement.t_us - other.t_us)
                innovation = self._core.innovation(state, measurement, other.moment, after_s)
                state = self._core.correct(state, innovation)
            other.state = state
