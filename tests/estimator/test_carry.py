"""Late measurements that are carried on to the nodes after them: what computing all of them again would give."""

import numpy as np
import pytest
from truth import Faults, World, tank_jet

from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator import carry
from autopilot.estimator.carry import Correction, PastUpdate
from autopilot.estimator.ekf import create_ekf
from autopilot.estimator.states import NX, FilterState


def updated(
    x: FloatArray, p: FloatArray, h: FloatArray, z: FloatArray, noise: FloatArray
) -> tuple[FilterState, PastUpdate]:
    """The textbook's."""
    spread = h @ p @ h.T + noise
    gain = p @ h.T @ np.linalg.inv(spread)
    y = z - h @ x
    return FilterState(x + gain @ y, p - gain @ spread @ gain.T), PastUpdate(gain, h, spread, y)


@pytest.mark.parametrize("seed", range(8))
def test_what_is_carried_is_what_computing_again_gives(seed: int) -> None:
    """Any linear filter, two late measurements at one node and one behind it, updates on the way: to rounding."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(NX, NX))
    start = FilterState(rng.normal(size=NX), 0.1 * root @ root.T)
    steps = [np.eye(NX) + 0.1 * rng.normal(size=(NX, NX)) for _ in range(6)]
    noise = 0.01 * np.eye(NX)
    sights = {i: (rng.normal(size=(m, NX)), rng.normal(size=m)) for i, m in ((0, 2), (2, 1), (3, 2), (5, 3))}

    def flown(late: list[tuple[int, FloatArray, FloatArray]]) -> tuple[list[FilterState], list[PastUpdate | None]]:
        state, states, looks = start, [], []
        for i, f in enumerate(steps):
            state, look = FilterState(f @ state.x, f @ state.p @ f.T + noise), None
            if i in sights:
                h, z = sights[i]
                state, look = updated(state.x, state.p, h, z, 0.1 * np.eye(len(z)))
            for at, h, z in late:
                if at == i:
                    state, _ = updated(state.x, state.p, h, z, 0.05 * np.eye(len(z)))
            states.append(state)
            looks.append(look)
        return states, looks

    late = [(1, rng.normal(size=(m, NX)), rng.normal(size=m)) for m in (4, 1)] + [
        (3, rng.normal(size=(4, NX)), rng.normal(size=4))
    ]
    states, looks = flown([])
    wanted, wanted_looks = flown(late)
    node, correction = states[1], None
    for _, h, z in late[:2]:
        node, look = updated(node.x, node.p, h, z, 0.05 * np.eye(len(z)))
        new = Correction(look.gain, look.spread, look.y)
        correction = new if correction is None else correction.joined(new)
    assert correction is not None
    for i in range(2, len(steps)):
        correction = correction._replace(w=steps[i] @ correction.w)
        old = looks[i]
        if old is not None:
            correction, carried = correction.through(old)
            if i <= 3:  # behind node 3 the late one there plays a part, too
                right = wanted_looks[i]
                assert right is not None
                for a, b in zip(carried, right, strict=True):
                    np.testing.assert_allclose(a, b, atol=1e-9)
            looks[i] = carried
        state = correction.on(states[i])
        if i == 3:
            _, h, z = late[2]
            state, look = updated(state.x, state.p, h, z, 0.05 * np.eye(4))
            correction = correction.joined(Correction(look.gain, look.spread, look.y))
        np.testing.assert_allclose(state.x, wanted[i].x, atol=1e-8)
        np.testing.assert_allclose(state.p, wanted[i].p, atol=1e-8)


def test_in_flight_it_changes_next_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fixes 60 ms late, carried or computed again: the same within a fiftieth of a standard deviation."""
    carried_on = np.array(flight())
    monkeypatch.setattr(carry, "LINEAR", np.full(NX, -1.0))
    again = np.array(flight())
    values, variance = (carried_on - again)[:, :7], again[:, 7:]
    assert values.any()
    assert (np.abs(values) <= 0.02 * np.sqrt(variance)).all()
    assert (np.abs(carried_on[:, 7:] - variance) <= 0.02 * variance).all()


def flight() -> list[list[float]]:
    """Position, heading and velocity relative to the water from the third second on, and their variances."""
    estimator = create_ekf(load_vehicle("lbv150"), None, 1.5)
    told = []
    for truth, samples, command in World(tank_jet, Faults(latency_us=60_000)).run(8.0):
        nav = estimator.step(truth.t_us, samples, command)
        if nav is not None and truth.t_us > 3_000_000:
            values = [*nav.pos_ned_m, nav.rpy_rad[2], *nav.vel_water_frd_m_s]
            told.append([*values, *nav.variance[[0, 1, 2, 5, 6, 7, 8]]])
    return told


@pytest.mark.parametrize("seed", range(4))
def test_rounding_does_not_grow_from_fix_to_fix(seed: int) -> None:
    """What differs between a matrix and its transpose ends at every correction, or in a minute no root is left."""
    rng = np.random.default_rng(seed)
    crooked = 1e-9 * rng.normal(size=(NX, NX))
    root = rng.normal(size=(NX, NX))
    state = FilterState(np.zeros(NX), root @ root.T + crooked)
    h = rng.normal(size=(4, NX))
    _, look = updated(state.x, state.p, h, rng.normal(size=4), 0.1 * np.eye(4))
    _, other = updated(state.x, state.p, rng.normal(size=(2, NX)), rng.normal(size=2), 0.1 * np.eye(2))
    after, seen = Correction(look.gain, look.spread, look.y).through(other)
    p = after.on(state).p
    for matrix in (after.c, seen.spread, p):
        assert np.array_equal(matrix, matrix.T)
