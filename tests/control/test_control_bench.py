"""The benchmark runs, compares the same problems and reports plain numbers."""

import pytest

from autopilot.bench.nmpc import bench_nmpc
from autopilot.control.nmpc.grid import uniform_grid


@pytest.mark.long
def test_bench_gives_rows_per_grid_and_solutions_that_agree() -> None:
    ticks = iter(range(1_000_000))
    rows = bench_nmpc(30, 10, [("uniform", uniform_grid(8))], cpu_clock=lambda: next(ticks) * 1e-3, starts=2)
    by_name = {(row.what, row.solver): row for row in rows}
    whole = [row for row in rows if row.what == "uniform, whole step"]
    assert {row.solver for row in whole} in ({"native", "hpipm"}, {"hpipm"})
    assert all(row.n == 8 and row.samples is not None and 25 <= row.samples < 30 for row in whole)
    assert whole[0].median_ms == pytest.approx(1.0)
    assert float(whole[0].note.split("within ")[1].split(" N")[0]) < 0.3
    parts = [row for row in rows if "part:" in row.what]
    assert len(parts) == 6
    shares = [float(row.note.split(" %")[0]) for row in parts]
    assert sum(shares) == pytest.approx(100.0, abs=3.0)
    assert min(shares[:4]) > 0.0
    assert "whole step / QP" in parts[0].note
    for solver in ("IPOPT, warm", "fatrop, warm"):
        row = by_name["uniform, the same problems", solver]
        assert row.samples == 3
        assert "not solved" not in row.note
    assert [row.what for row in rows if "obstacles" in row.what] == [f"{k} obstacles, geometric" for k in (2, 10, 50)]
    assert by_name["80 steps from 2 random starts", rows[-2].solver].note.startswith("0 failures")
    assert rows[-1].what == "start-up, controller alone"
