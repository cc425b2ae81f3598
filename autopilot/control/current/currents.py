"""Current along the prediction: estimated, from a map with a correction, learned, or none."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.control.current.current_tuning import CURRENT_MEMORY, CURRENTS
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import NavHealth, NavState

Pointwise: TypeAlias = Callable[[tuple[float, float, float], float], tuple[float, float, float]]
"""Position NED [m] and time [s] -> velocity NED [m/s]."""
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
    """Estimated currents on a coarse periodic grid, weighted means (3,) by position. Bounded (0.9 MB), deterministic;
    planar: an estimate counts at all depths.

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


class CurrentForecast(Protocol):
    """Current at every stage of the prediction."""

    def view(self, nav: NavState) -> NavState:
        """The estimate as the controller is to take it; called once per control step, before everything else."""
        ...

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Write the current (n, 3) at predicted positions (n, 3), ``t_s`` (n,) after ``nav``."""
        ...

    def revision(self, nav: NavState) -> int:
        """Grows when the forecast is another one (by MATERIAL_M_S) than at the last revision: time to plan anew."""
        ...

    def within(self, fence: Fence) -> None:
        """Learn of the fence in force; called when there is another one."""
        ...


class KnownCurrent(Protocol):
    """A current given in advance: :class:`autopilot.control.current.current_map.CurrentMap`, or a formula."""

    @property
    def scale_m(self) -> float:
        """Length scale of the current and of its error [m]."""
        ...

    def velocity(self, pos_ned_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """(m, 3) NED [m/s] at places (m, 3) and times (m,) of the service's clock."""
        ...

    def drift_m_s(self, before_s: float, after_s: float) -> float:
        """Upper bound of its change between two times [m/s]."""
        ...


class PointwiseField:
    """A formula for one place as a :class:`KnownCurrent`."""

    def __init__(self, field: Pointwise, scale_m: float = CURRENTS.tank_scale_m) -> None:
        self._field = field
        self.scale_m = scale_m

    def velocity(self, pos_ned_m: FloatArray, t_s: FloatArray) -> FloatArray:
        field = self._field
        places, times = pos_ned_m.tolist(), t_s.tolist()
        return np.array([field((x, y, z), t) for (x, y, z), t in zip(places, times, strict=True)]).reshape(-1, 3)

    def drift_m_s(self, before_s: float, after_s: float) -> float:
        """Looked at in the origin: formulas change everywhere alike (tides) or not at all."""
        here = (0.0, 0.0, 0.0)
        return math.dist(self._field(here, before_s), self._field(here, after_s))


def _no_drift(before_s: float, after_s: float) -> float:
    """Time derivative of a steady current: zero."""
    return 0.0


class Revision:
    """Counts how often a vector has moved by MATERIAL_M_S, or time by as much as changes a field so far."""

    def __init__(self, drift_m_s: Callable[[float, float], float] = _no_drift) -> None:
        self._drift_m_s = drift_m_s
        self._seen_m_s: FloatArray | None = None
        self._seen_s = 0.0
        self.count = 0

    def update(self, value_m_s: FloatArray, now_s: float) -> int:
        """The revision after comparison with a vector (3,)."""
        if self._seen_m_s is None:
            self._seen_m_s, self._seen_s = value_m_s.copy(), now_s
        moved_m_s = float(np.abs(value_m_s - self._seen_m_s).max())
        if moved_m_s > CURRENTS.material_m_s or self._drift_m_s(self._seen_s, now_s) > CURRENTS.material_m_s:
            self._seen_m_s, self._seen_s = value_m_s.copy(), now_s
            self.count += 1
        return self.count


class _Anywhere:
    """A forecast that does not depend on the fence."""

    def within(self, fence: Fence) -> None:
        """No-op: nothing to learn."""


class EstimatedCurrent(_Anywhere):
    """The estimate holds over the whole horizon."""

    def __init__(self) -> None:
        self._revision = Revision()

    def view(self, nav: NavState) -> NavState:
        return nav

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        out[:] = nav.current_ned_m_s

    def revision(self, nav: NavState) -> int:
        return self._revision.update(nav.current_ned_m_s, nav.t_us * 1e-6)


class MappedCurrent(_Anywhere):
    """A current map, corrected by its residual against the estimate: near visited positions the stored one, elsewhere
    the present one.
    """

    def __init__(self, field: KnownCurrent) -> None:
        self._field = field
        self._memory = CurrentMemory(field.scale_m)
        self._revision = Revision(field.drift_m_s)

    def view(self, nav: NavState) -> NavState:
        numbers = (*nav.current_ned_m_s.tolist(), *nav.pos_ned_m.tolist())
        if nav.health is NavHealth.GOOD and all(map(math.isfinite, numbers)):
            here = self._field.velocity(nav.pos_ned_m[None], np.array([nav.t_us * 1e-6]))[0]
            variance = 0.5 * (nav.variance.item(9) + nav.variance.item(10))
            self._memory.learn(nav.t_us, nav.pos_ned_m, nav.current_ned_m_s - here, variance)
        return nav

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Map and memory at each predicted place and time, plus the correction as far as it holds there and then."""
        forecast = self._forecast(nav, np.vstack((pos_ned_m, nav.pos_ned_m)), np.append(t_s, 0.0))
        out[:] = forecast[:-1]
        fraction = correction_fraction(nav, pos_ned_m, t_s, self._field.scale_m)
        out += fraction[:, None] * (nav.current_ned_m_s - forecast[-1])

    def revision(self, nav: NavState) -> int:
        """The estimate surprises by something else than at the last revision, or the map has moved on."""
        here = self._forecast(nav, nav.pos_ned_m[None], np.zeros(1))[0]
        return self._revision.update(nav.current_ned_m_s - here, nav.t_us * 1e-6)

    def _forecast(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """(n, 3) map and memory at places, ``t_s`` after ``nav``."""
        on_map = self._field.velocity(pos_ned_m, t_s + nav.t_us * 1e-6)
        return on_map + self._memory.recall(nav.t_us, pos_ned_m, np.zeros(3))


def correction_fraction(
    nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, scale_m: float = CURRENTS.tank_scale_m
) -> FloatArray:
    """(n,) how much of the present correction holds at places and times: all of it round the vehicle, within LASTING_S.

    A vehicle that holds its goal predicts to stay there. A correction that faded along that prediction would announce a
    current that never comes, and the plan would lean against it: an offset from the goal. Hence no fading in time
    within the horizon, and none in space within the acceptance ball.
    """
    distance_m = np.maximum(np.sqrt(np.square(pos_ned_m - nav.pos_ned_m).sum(axis=1)) - CURRENTS.full_within_m, 0.0)
    fraction: FloatArray = np.exp(
        -0.5 * np.square(distance_m / scale_m) - np.maximum(t_s - CURRENTS.lasting_s, 0.0) / CURRENTS.fade_s
    )
    return fraction


class NoCurrent(_Anywhere):
    """Unaware of currents: speed over ground is taken for speed in the water."""

    def view(self, nav: NavState) -> NavState:
        return replace(nav, current_ned_m_s=np.zeros(3), vel_water_frd_m_s=nav.vel_frd_m_s)

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        out[:] = 0.0

    def revision(self, nav: NavState) -> int:
        return 0
