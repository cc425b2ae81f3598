"""Estimated currents by position: a coarse periodic grid of weighted means."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.control.current.current_tuning import CURRENT_MEMORY
from autopilot.core.frames import FloatArray

PRIOR_WEIGHT = 0.1 / CURRENT_MEMORY.variance_floor_m2_s2
"""Weight [s^3/m^2] of what is believed without memory: a tenth of a second of good estimates at the node. With
more the first lap is worse, with less nothing changes (docs/control.md)."""


@dataclass(slots=True, eq=False)
class _Patch:
    """The 5 x 5 nodes round the vehicle: looked up when it enters another cell, updated in a buffer until it leaves or
    a query arrives.
    """

    node: tuple[int, int]
    """The one in the middle."""
    north_m: FloatArray
    """(5,) of its rows."""
    east_m: FloatArray
    """(5,) of its columns."""
    slot: NDArray[np.int64]
    """(25,) where they are kept."""
    place: NDArray[np.int64]
    """(25,) which nodes they are among all that are kept there."""
    sums: FloatArray
    """(25, 4) of them."""
    learned_us: int
    """Time of the last update of all of them."""


class CurrentMemory:
    """Means (3,) by position. Bounded (0.9 MB), deterministic; planar: an estimate counts at all depths.

    The nodes carry sums of weights w and of w c, w = duration / (variance + floor) times a Gaussian of the distance.
    At a position the result is (sum of w c + w0 c0) / (sum of w + w0), the sums interpolated between the four nodes
    round it and c0 the prior: a kernel average (Nadaraya-Watson) with a prior.
    """

    def __init__(self, scale_m: float) -> None:
        """``scale_m``: length over which the current changes."""
        self._cell_m = scale_m / CURRENT_MEMORY.cells_per_scale
        self._spread_m = CURRENT_MEMORY.spread * scale_m
        self._sums: FloatArray = np.zeros((CURRENT_MEMORY.nodes * CURRENT_MEMORY.nodes, 4))
        self._place: NDArray[np.int64] = np.full(CURRENT_MEMORY.nodes * CURRENT_MEMORY.nodes, -1, dtype=np.int64)
        self._learned_us: FloatArray = np.zeros(CURRENT_MEMORY.nodes * CURRENT_MEMORY.nodes)
        self._around = np.arange(-CURRENT_MEMORY.reach, CURRENT_MEMORY.reach + 1)
        self._patch: _Patch | None = None
        """Where the last lesson was."""
        self._last_us: int | None = None

    def learn(self, t_us: int, pos_ned_m: FloatArray, seen_m_s: FloatArray, variance_m2_s2: float) -> None:
        """Add an estimate (3,) at a position (3,), weighted by the time since the last call."""
        elapsed_s = 0.0 if self._last_us is None else (t_us - self._last_us) * 1e-6
        self._last_us = t_us
        if elapsed_s <= 0.0:
            return
        x, y = pos_ned_m[:2].tolist()
        patch = self._patch_round((round(x / self._cell_m), round(y / self._cell_m)), t_us)
        r2 = np.add.outer(np.square(patch.north_m - x), np.square(patch.east_m - y)).reshape(-1)
        gain = min(elapsed_s, CURRENT_MEMORY.longest_lesson_s) / (
            max(variance_m2_s2, 0.0) + CURRENT_MEMORY.variance_floor_m2_s2
        )
        weight = gain * np.exp(-0.5 * r2 / self._spread_m**2)
        patch.sums += weight[:, None] * np.array((1.0, *seen_m_s.tolist()))

    def _patch_round(self, node: tuple[int, int], t_us: int) -> _Patch:
        """The nodes round one, with their weights after ageing."""
        patch = self._patch
        if patch is not None and patch.node == node:
            patch.sums *= _left(patch.learned_us, t_us)
            patch.learned_us = t_us
            return patch
        self._put_back()
        north, east = node[0] + self._around, node[1] + self._around
        slot, place = (found.reshape(-1) for found in _slot(north[:, None], east))
        north_m, east_m = (np.asarray(nodes * self._cell_m, dtype=float) for nodes in (north, east))
        sums = self._sums[slot] * self._kept(slot, place, t_us)[:, None]
        self._patch = patch = _Patch(node, north_m, east_m, slot, place, sums, t_us)
        return patch

    def _put_back(self) -> None:
        patch = self._patch
        if patch is not None:
            self._sums[patch.slot], self._place[patch.slot] = patch.sums, patch.place
            self._learned_us[patch.slot] = patch.learned_us

    def recall(self, t_us: int, pos_ned_m: FloatArray, prior_m_s: FloatArray) -> FloatArray:
        """(n, 3) means at positions (n, 3); ``prior_m_s`` (3,) without data."""
        self._put_back()
        scaled = pos_ned_m[:, :2].T / self._cell_m
        corner = np.floor(scaled)
        ahead = scaled - corner
        # (2, n) of north and of east: the nodes before and behind every place, and how near they are.
        north, east = corner.astype(np.int64)[:, None] + _BEFORE_AND_BEHIND
        near_n, near_e = np.stack((1.0 - ahead, ahead), axis=1)
        slot, place = _slot(north[:, None], east)
        weight = near_n[:, None] * near_e * self._kept(slot, place, t_us)
        sums = (weight[..., None] * self._sums[slot]).reshape(4, -1, 4).sum(axis=0)
        out: FloatArray = (sums[:, 1:] + PRIOR_WEIGHT * prior_m_s) / (sums[:, :1] + PRIOR_WEIGHT)
        return out

    def _kept(self, slot: NDArray[np.int64], place: NDArray[np.int64], t_us: int) -> FloatArray:
        """Remaining weight of a node; zero if its slot holds another position."""
        return np.where(self._place[slot] == place, _left(self._learned_us[slot], t_us), 0.0)


def _left(learned_us: float | FloatArray, t_us: int) -> FloatArray:
    """Remaining fraction of a weight after ageing."""
    return np.exp((learned_us - t_us) * (1e-6 / CURRENT_MEMORY.forget_s))


_BEFORE_AND_BEHIND: NDArray[np.int64] = np.array([[0], [1]])


def _slot(north: NDArray[np.int64], east: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Slot of a node, and a number that distinguishes the nodes of one slot."""
    slot = (north % CURRENT_MEMORY.nodes) * CURRENT_MEMORY.nodes + east % CURRENT_MEMORY.nodes
    return slot, (north // CURRENT_MEMORY.nodes + (1 << 20)) * (1 << 22) + (east // CURRENT_MEMORY.nodes + (1 << 20))
