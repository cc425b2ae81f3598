"""Pytest plugin: tests run with the library that an environment variable names (:mod:`tests.sanitize`)."""

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from autopilot.control.energy import interval
from autopilot.core import compiled
from tests.sanitize import PATH_VARIABLE

compiled.LIBRARY = Path(os.environ[PATH_VARIABLE])
# CasADi would load it a second time, in a way that the sanitizer cannot follow.
cast(Any, interval).compiled = SimpleNamespace(library=lambda: None)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Without the library all would be skipped, and nothing found."""
    wrong = compiled.missing()
    if wrong:
        pytest.exit(f"the library with sanitizers is not used: {wrong}", returncode=1)
