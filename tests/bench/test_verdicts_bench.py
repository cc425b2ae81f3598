"""A few worlds of :mod:`tests.bench.verdicts`: both verdicts occur, and none differs."""

from tests.bench.verdicts import judged


def test_the_plan_check_agrees_with_a_grid_search() -> None:
    kinds = {judged(seed).kind for seed in (50_000, 50_003, 50_006, 50_012)}
    assert kinds == {"refused by both", "accepted by both"}
