"""The notebooks of docs/examples run, cell by cell, with shorter flights."""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
SHORTER: dict[str, dict[str, Any]] = {
    "fly_the_paper": {"SECONDS": 30.0},
    "change_a_weight": {"SECONDS": 8.0, "WEIGHTS": (0.005, 0.08)},
    "own_controller": {"SECONDS": 12.0},
    "monte_carlo": {"RUNS": 3, "SECONDS": 6.0},
    "current_map": {"SECONDS": 12.0},
    "parts": {"STEPS": 80},
    "read_log": {"SECONDS": 6.0},
}
"""Values instead of those in the cell that is tagged ``parameters``."""


def test_every_notebook_is_run_here() -> None:
    assert set(SHORTER) == {path.stem for path in EXAMPLES.glob("*.ipynb")}


@pytest.mark.parametrize("name", SHORTER)
def test_a_notebook_runs(name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    notebook = json.loads((EXAMPLES / f"{name}.ipynb").read_text(encoding="utf-8"))
    monkeypatch.setattr(plt, "show", lambda: None)
    space: dict[str, Any] = {"__name__": "notebook"}
    with mpl.rc_context():
        mpl.use("Agg")
        for cell in notebook["cells"]:
            if cell["cell_type"] != "code":
                continue
            assert cell["outputs"] == [], "outputs grow old: clear them"
            exec(compile("".join(cell["source"]), f"{name}.ipynb", "exec"), space)
            if "parameters" in cell["metadata"].get("tags", ()):
                assert set(SHORTER[name]) <= set(space), "the test shortens what the notebook does not have"
                space.update(SHORTER[name])
        drawn = [axes for number in plt.get_fignums() for axes in plt.figure(number).axes if axes.has_data()]
        plt.close("all")
    assert capsys.readouterr().out
    assert drawn or name == "own_controller", "a table is all that this one shows"
