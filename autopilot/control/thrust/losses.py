"""Thruster faults in use: declared and detected losses, the remaining thrust, and the modes that it still permits."""

import numpy as np

from autopilot.control.thrust.redundancy import lossy_effectiveness, tilt_of, weak_thrusters
from autopilot.control.thrust.thrust_tuning import LOSSES
from autopilot.control.thrust.thruster_health import ThrusterHealth, configured_effectiveness, hover_problem, usable
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, NavState, ThrusterHealthState
from autopilot.core.params import ParamSet
from autopilot.core.response import Response
from autopilot.core.vehicle import Vehicle


class ThrusterLosses:
    """Combines declared losses (THRn_HEALTH) with detected ones (THR_DETECT); the smaller effectiveness is used."""

    def __init__(self, vehicle: Vehicle, params: ParamSet) -> None:
        self._names = tuple(thruster.name for thruster in vehicle.thrusters)
        self._params = params
        self._allocator = ControlAllocator.of(vehicle)
        self._health = ThrusterHealth(
            self._allocator.model,
            Response.of(vehicle.thrusters),
            tilt=tilt_of(vehicle),
            submerged_m=LOSSES.submerged * vehicle.hull_half_height_m,
        )
        self._report_us = 0
        self._known: tuple[list[float], FloatArray] | None = None
        """Declared and detected effectiveness at the last update."""
        self._revision = -1
        """Of the parameters at the last update."""
        self.effectiveness = np.ones(len(self._names))
        """(n,) effectiveness that bounds and allocation go by; dead thrusters have 0. Another array when it changes."""
        self.effectiveness_values = (1.0,) * len(self._names)
        """The same."""
        self.problem = ""
        """Lost capability, "" while the vehicle can keep its position."""
        self.doubtful: tuple[tuple[str, ...], ...] = ()
        """Redundant thrusters with a fault that is not isolated."""
        self.unseen: tuple[str, ...] = ()
        """Thrusters that have been asked for too little so far: the loss of half of one would not show."""

    def step(
        self,
        t_us: int,
        nav: NavState | None,
        pulse_n: FloatArray,
        capability_n: FloatArray,
        goal: Goal | None,
        *,
        armed: bool,
    ) -> ThrusterHealthState | None:
        """``pulse_n`` (n,): thrust of healthy thrusters for the pulses since the last call [N].

        ``capability_n`` (4,): attainable force of healthy ones, ``goal``: position of the vehicle's goal. Returns a
        record for the log, periodically and on changes.
        """
        self._find(t_us, nav, pulse_n, armed)
        changed = self._changed()
        if not changed and t_us < self._report_us:
            return None
        if t_us >= self._report_us:
            self._report_us = t_us + LOSSES.report_every_us
        self.problem = self._problem(nav, goal, np.minimum(capability_n, self._params["THR_LIMIT"]))
        detects = int(self._params["THR_DETECT"])
        self.unseen = tuple(n for n, seen in zip(self._names, self._health.seen, strict=True) if detects and not seen)
        return ThrusterHealthState(
            t_us=t_us,
            effectiveness=self.effectiveness.copy(),
            estimate=self._health.effectiveness,
            sigma=self._health.sigma,
        )

    def _changed(self) -> bool:
        """Whether :attr:`effectiveness` is another one than on the last tick."""
        revision, found = self._params.revision, self._health.found
        if revision == self._revision and self._known is not None and found is self._known[1]:
            return False
        self._revision = revision
        configured = configured_effectiveness(self._params, len(self._names))
        if self._known is not None and configured == self._known[0] and found is self._known[1]:
            return False
        self._known = (configured, found)
        before = self.effectiveness
        found, ambiguous = found.copy(), [list(redundant) for redundant in self._health.doubtful]
        for redundant in ambiguous:
            # A declared loss of one of them explains the detected loss of all.
            if (
                min(configured[redundant_one] for redundant_one in redundant)
                < lossy_effectiveness(found[redundant].tolist()) + LOSSES.same_loss
            ):
                found[redundant] = 1.0
        self.doubtful = tuple(
            tuple(self._names[i] for i in redundant) for redundant in ambiguous if found[redundant[0]] < 1.0
        )
        self.effectiveness = usable(np.minimum(configured, found))
        self.effectiveness_values = tuple(self.effectiveness.tolist())
        return bool((self.effectiveness != before).any())

    def _find(self, t_us: int, nav: NavState | None, pulse_n: FloatArray, armed: bool) -> None:
        if not int(self._params["THR_DETECT"]):
            self._health.reset()
        elif nav is None or not armed:
            self._health.pause()
        else:
            self._health.step(t_us, nav, pulse_n)

    def _problem(self, nav: NavState | None, goal: Goal | None, capability_n: FloatArray) -> str:
        """Named by the weak thrusters; a current that is too strong for sound ones is not their failure.

        With all thrusters alive a goal's heading may be met in passing; with a dead one it must be possible to stay.
        """
        weak = weak_thrusters(self._names, self.effectiveness.tolist(), self.doubtful)
        if not weak:
            return ""
        current = np.zeros(3) if nav is None else nav.current_ned_m_s
        yaw_rad = goal.yaw_rad if goal is not None and not self.effectiveness.all() else None
        problem = hover_problem(self._allocator, capability_n * self.effectiveness, current, yaw_rad)
        return f"{problem} (thruster {', '.join(weak)})" if problem else ""
