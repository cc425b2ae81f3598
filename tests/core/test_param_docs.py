"""The table of parameters in docs/parameters.md is the program's."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from autopilot.core.params import PARAMETERS

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(name="script")
def script_fixture(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(DOCS)  # the module beside it
    spec = importlib.util.spec_from_file_location("parameters_page", DOCS / "parameters_page.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_documented_parameters_are_the_programs(script: ModuleType) -> None:
    text = (DOCS / "parameters.md").read_text(encoding="utf-8")
    assert text == script.written(text), "run python docs/parameters_page.py --write"


def test_numbered_parameters_that_share_a_row_differ_in_nothing_else() -> None:
    for family in ("BTN", "THR"):
        numbered = [spec for spec in PARAMETERS if spec.name.startswith(family) and spec.name[3].isdigit()]
        assert len(numbered) > 1
        assert len({(spec.default, spec.minimum, spec.maximum, spec.unit) for spec in numbered}) == 1
