"""docs/browser.py, which is in no package, as a module."""

import importlib.util
from pathlib import Path
from types import ModuleType


def _loaded() -> ModuleType:
    file = Path(__file__).resolve().parents[1] / "docs" / "browser.py"
    spec = importlib.util.spec_from_file_location("browser", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


browser = _loaded()
