"""Faults of the simulated hull and its battery: pushes, snags, loss of charge."""

from collections.abc import Iterable, Sequence
from typing import TypeAlias

from autopilot.core.frames import r_ned_from_frd, rpy_from_quat
from autopilot.core.toml_table import Vec3
from autopilot.sitl.fault_tables import BatterySag, Mishap, Shove, Snag

Forces: TypeAlias = tuple[Vec3, Vec3]
"""Force NED [N], moment FRD [N m]."""

NONE: Forces = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class ScheduledFaults:
    """The mishaps of a scenario, in time."""

    def __init__(self, mishaps: Iterable[Mishap]) -> None:
        mishaps = list(mishaps)
        self._forces = [m for m in mishaps if isinstance(m, Shove | Snag)]
        self._sags = sorted((m for m in mishaps if isinstance(m, BatterySag)), key=lambda sag: sag.at_s)
        self._caught: dict[int, tuple[float, float, float]] = {}
        self._acts = False

    def add(self, mishap: Mishap) -> None:
        if isinstance(mishap, BatterySag):
            self._sags = sorted([*self._sags, mishap], key=lambda sag: sag.at_s)
        else:
            self._forces.append(mishap)

    @property
    def none(self) -> bool:
        """Nothing is going to happen any more."""
        return not (self._forces or self._sags)

    def sagged(self, t_us: int) -> float | None:
        """Share of the charge that is left from now on, on the step on which that changes."""
        if self._sags and self._sags[0].at_s * 1e6 <= t_us:
            return self._sags.pop(0).remaining
        return None

    def forces(self, t_us: int, state: Sequence[float]) -> Forces | None:
        """Force and moment from now on, None = unchanged zero. ``state``: position NED, quaternion, velocity FRD."""
        acting = [(n, fault) for n, fault in enumerate(self._forces) if fault.holds(t_us)]
        if not acting:
            was, self._acts = self._acts, False
            return NONE if was else None
        self._acts = True
        force, moment = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        for number, fault in acting:
            if isinstance(fault, Shove):
                force = [a + b for a, b in zip(force, fault.force_ned_n, strict=True)]
                moment = [a + b for a, b in zip(moment, fault.moment_frd_n_m, strict=True)]
                continue
            place = self._caught.setdefault(number, (state[0], state[1], state[2]))
            vel = (r_ned_from_frd(rpy_from_quat(state[3:7])) @ state[7:10]).tolist()
            for axis in range(3):
                pull_n = fault.stiffness_n_m * (place[axis] - state[axis]) - fault.damping_n_s_m * vel[axis]
                force[axis] += pull_n
        fx, fy, fz = force
        mx, my, mz = moment
        return (fx, fy, fz), (mx, my, mz)
