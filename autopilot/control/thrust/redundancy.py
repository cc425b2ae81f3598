"""Fault isolation among redundant thrusters: those with equal columns in the 4-DoF allocation matrix.

The two verticals of a BlueROV2 have the same column: the motion in the four axes shows that one of them has failed,
but not which. The tilt isolates it: one pushes to starboard of the centre of gravity, the other to port. Restoring
moment, trim and damping in roll and pitch are not in a vehicle file; they are fitted together with the loss, over some
ten seconds before and after it:

    roll rate = g (sum of arm x thrust) - l (arm x thrust of the suspect, since the loss)
                + k sin(roll) + d (roll rate) + b

The evidence for a suspect is the marginal likelihood of the data, all fitted parameters integrated out. It only
selects among redundant thrusters; detection is left to :mod:`autopilot.control.thrust.loss_bank`.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from autopilot.control.thrust.filtered_motion import FilteredMotion
from autopilot.control.thrust.thrust_tuning import REDUNDANCY
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import Model4
from autopilot.core.thrusters import wrench_matrix
from autopilot.core.vehicle import Vehicle

BEGUN_S = np.arange(0.5, 25.0, 1.0)
"""Possible starts of a loss before its declaration; the most likely one counts."""

MEANS = np.array([0.75, 1.0, -5.0, -1.0, 0.0])
SPREADS = np.array([0.4, 0.5, 10.0, 5.0, 3.0])
"""Believed of l and g (as shares of 1 / inertia), k [1/s^2], d [1/s] and b [rad/s^2]."""


def alike(model: Model4) -> np.ndarray:
    """(n, n) bool, pairs of redundant thrusters, diagonal included; columns of opposite sign count."""
    columns = np.array(model.allocation) / np.sqrt(np.array(model.mass_kg))[:, None]
    columns = columns / np.linalg.norm(columns, axis=0)
    sines = np.sqrt(np.maximum(1.0 - np.square(columns.T @ columns), 0.0))
    result: np.ndarray = (sines < REDUNDANCY.alike) | np.eye(columns.shape[1], dtype=bool)
    return result


def tilt_of(vehicle: Vehicle) -> FloatArray:
    """(2, n) roll and pitch acceleration per N of each thruster [rad/s^2]; with the inertia of yaw where the file has
    no other.
    """
    thrusters = vehicle.thrusters
    wrench = np.array(wrench_matrix([t.position_frd_m for t in thrusters], [t.direction_frd for t in thrusters]))
    yaw = vehicle.to_model().mass_kg[3]
    inertia = (yaw, yaw) if vehicle.levelling is None else vehicle.levelling.inertia_kg_m2
    result: FloatArray = wrench[3:5] / np.array(inertia)[:, None]
    return result


def lossy_effectiveness(effectivenesses: Sequence[float]) -> float:
    """Effectiveness of the faulty one of several redundant thrusters with that common effectiveness, the others
    healthy.
    """
    return max(0.0, sum(effectivenesses) - (len(effectivenesses) - 1))


def weak_thrusters(
    names: Sequence[str], effectivenesses: Sequence[float], doubtful: Sequence[Sequence[str]]
) -> list[str]:
    """Text: thrusters with reduced effectiveness; of ``doubtful`` redundant ones, that one of them is, not isolated."""
    effectiveness_of = dict(zip(names, effectivenesses, strict=True))
    alone = [
        name for name in names if effectiveness_of[name] < 1.0 and not any(name in redundant for redundant in doubtful)
    ]
    left = [
        (", ".join(redundant), lossy_effectiveness([effectiveness_of[name] for name in redundant]))
        for redundant in doubtful
    ]
    return [f"{name} {100.0 * effectiveness_of[name]:.0f} %" for name in alone] + [
        f"one of {redundant} {100.0 * left_effectiveness:.0f} %" for redundant, left_effectiveness in left
    ]


class TiltEvidence:
    """Evidence among redundant thrusters from recent roll and pitch. ``tilt`` (2, n) as of :func:`tilt_of`."""

    def __init__(self, tilt: FloatArray) -> None:
        self._tilt = tilt
        self._motions: deque[tuple[float, FilteredMotion]] = deque(maxlen=REDUNDANCY.kept_updates)
        self.clock_s = 0.0
        """Total time of all updates."""
        self.updates = 0
        """Number of updates."""

    def forget(self, updates: int = REDUNDANCY.kept_updates) -> None:
        for _ in range(min(updates, len(self._motions))):
            self._motions.pop()

    def update(self, motion: FilteredMotion) -> None:
        self.clock_s += motion.dt_s
        self.updates += 1
        self._motions.append((self.clock_s, motion))

    def tells(self, suspects: Sequence[int]) -> bool:
        """Whether they tilt the hull differently at all."""
        return bool((np.ptp(self._tilt[:, list(suspects)], axis=1) > REDUNDANCY.same_arm).any())

    def of(self, suspects: Sequence[int], by_s: float, others: FloatArray) -> FloatArray:
        """(suspects,) evidence for each [nats], the worst 0: loss of thrust before the time ``by_s``, the others with
        effectiveness ``others`` (n,).
        """
        evidence, arms = np.zeros(len(suspects)), self._tilt[:, list(suspects)]
        axes = np.flatnonzero(np.ptp(arms, axis=1) > REDUNDANCY.same_arm)
        if not len(axes) or not self._motions:
            return evidence
        clock_s, motions = zip(*self._motions, strict=True)
        begins = np.unique(np.searchsorted(clock_s, by_s - BEGUN_S, side="right").clip(max=len(motions) - 1))
        independent_fraction = min(1.0, float(np.mean([motion.dt_s for motion in motions])) / REDUNDANCY.independent_s)
        thrust_n, tilts = (
            np.array([motion.thrust_n for motion in motions]),
            np.array([motion.tilt for motion in motions]),
        )
        likely = np.zeros((len(suspects), len(begins)))
        for axis in axes:
            seen, angle, rate = tilts[:, axis].T
            healthy = np.column_stack([thrust_n @ (self._tilt[axis] * others), angle, rate, np.ones(len(motions))])
            lacking = -thrust_n[:, list(suspects)] * arms[axis]
            likely += _likelihoods(healthy, lacking, begins, seen, independent_fraction)
        evidence = likely.max(axis=1)
        result: FloatArray = evidence - evidence.min()
        return result


def _likelihoods(
    healthy: FloatArray, lacking: FloatArray, begins: np.ndarray, seen: FloatArray, independent_fraction: float
) -> FloatArray:
    """(suspects, begins) log-likelihood of ``seen`` (m,), explained by ``healthy`` (m, 4) and, from update ``begins``
    on, by one column of ``lacking`` (m, suspects); noise from the best fit, with
    ``independent_fraction`` the fraction of independent updates.
    """
    suspects, times = lacking.shape[1], len(begins)
    prior, rest = np.diag(1.0 / np.square(SPREADS)), seen - healthy @ MEANS[1:]

    def since(terms: FloatArray) -> FloatArray:
        """Sum of ``terms`` (m, suspects, ...) from each of ``begins`` on, (suspects, begins, ...)."""
        return np.moveaxis(np.cumsum(terms[::-1], axis=0)[::-1][begins], 0, 1)

    squares = since(np.square(lacking))
    gram = np.zeros((suspects, times, 5, 5))
    gram[..., 0, 0] = squares
    gram[..., 1:, 1:] = healthy.T @ healthy
    gram[..., 0, 1:] = gram[..., 1:, 0] = since(lacking[:, :, None] * healthy[:, None, :])
    # Right-hand side of the normal equations, relative to the prior means.
    moved = np.empty((suspects, times, 5))
    moved[..., 0] = since(lacking * rest[:, None]) - MEANS[0] * squares
    moved[..., 1:] = healthy.T @ rest - MEANS[0] * gram[..., 0, 1:]
    total = float(rest @ rest) - 2.0 * MEANS[0] * since(lacking * rest[:, None]) + MEANS[0] ** 2 * squares
    variance, evidence = REDUNDANCY.first_noise**2, np.zeros((suspects, times))
    for _ in range(3):
        weight = independent_fraction / variance
        a, b = weight * gram + prior, weight * moved
        found = np.linalg.solve(a, b[..., None])[..., 0]
        evidence = -0.5 * (weight * total - (b * found).sum(-1) + np.linalg.slogdet(a)[1])
        missed = total - 2.0 * (found * moved).sum(-1) + np.einsum("...i,...ij,...j->...", found, gram, found)
        variance = max(float(missed.min()) / len(seen), REDUNDANCY.least_noise**2)
    return evidence
