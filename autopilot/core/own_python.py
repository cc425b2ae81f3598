"""Python child processes: they import what their parent does, and nothing from the current folder.

Without ``-P`` Python searches the current folder first: a ``logging.py`` or a package ``autopilot`` of the user's
would be imported instead of the right one. ``tests/test_child_processes.py`` lists every place that starts one.
"""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds the package: a checkout, or site-packages."""

SAFE_PATH = "PYTHONSAFEPATH"
"""The variable that stands for ``-P`` where the command line is not ours."""


def python_command(code: str, checkout: Path | None = None) -> list[str]:
    """Command that runs ``code`` with our packages, or those of another ``checkout``, and nothing from the current
    folder."""
    root = str(checkout or ROOT)
    known = f"{root!r} in map(os.path.realpath, sys.path)" if checkout is None else "False"
    door = f"import os, sys; sys.path[:0] = [] if {known} else [{root!r}]\n"
    return [sys.executable, "-P", "-c", door + code]


@contextlib.contextmanager
def safe_path() -> Iterator[None]:
    """Make processes that libraries start (multiprocessing's servers and workers, a Dask cluster's) not import from
    the current folder either. The libraries pass on the parent's ``sys.path``.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before
