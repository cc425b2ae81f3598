"""The benchmark runs, compares the same problems and reports plain numbers."""

import pytest

from autopilot.bench.nmpc import bench_nmpc
from autopilot.control.grid import uniform_grid


def test_bench_gives_two_rows_per_grid_and_solutions_that_agree() -> None:
    ticks = iter(range(1_000_000))
    rows = bench_nmpc(30, 10, [("uniform", uniform_grid(8))], cpu_clock=lambda: next(ticks) * 1e-3)
    ours, ipopt = rows
    assert (ours.n, ours.samples, ipopt.samples) == (8, 30, 3)
    assert ours.solver == "controller step (hpipm)"
    assert ours.median_ms == pytest.approx(1.0)
    assert ours.thrust_gap_n < 0.3
    assert "IPOPT" in ipopt.solver
