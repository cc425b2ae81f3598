"""docs/browser.py, which is in no package, as a module; and the mark of tests that need a Chromium."""

import importlib.util
import os
from pathlib import Path
from types import ModuleType

import pytest


def _loaded() -> ModuleType:
    file = Path(__file__).resolve().parents[1] / "docs" / "browser.py"
    spec = importlib.util.spec_from_file_location("browser", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


browser = _loaded()

needs_browser = pytest.mark.skipif(
    browser.found() is None and not os.environ.get("CI"), reason="no Chromium here; CHROMIUM names one"
)
"""Skipped without one, but not where the environment variable CI is set: there these tests fail."""


def pixels_of(canvas: str) -> str:
    """JavaScript for the red, green, blue, alpha of each pixel of the canvas with this id.

    A copy is read: Chromium warns on the console of a canvas that is read again and again.
    """
    return f"""((canvas) => {{
        const {{ width, height }} = canvas;
        const copy = new OffscreenCanvas(width, height).getContext("2d", {{ willReadFrequently: true }});
        copy.drawImage(canvas, 0, 0);
        return copy.getImageData(0, 0, width, height).data;
    }})(document.getElementById("{canvas}"))"""
