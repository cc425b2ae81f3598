"""Git revision of the running code."""

import os
import subprocess
from functools import cache
from pathlib import Path

from autopilot.run.children import ROOT

_OURS = ("autopilot", "drivers", "estimator", "mission", "sitl", "pyproject.toml")
"""Sources of the running code; other files of the tree do not change it."""
_HASH_DIGITS = 8


@cache
def revision() -> str:
    """Git revision of the running code as it was at the first call; see :func:`revision_of`."""
    return revision_of(ROOT)


def revision_of(root: Path) -> str:
    """Revision of the checkout ``root``, with ``-dirty`` when tracked code differs from it; "" without a checkout.

    An installed package often lies inside an unrelated repository: the repository's root has to be the folder that
    holds our packages and our pyproject.toml.
    """
    if not (root / "autopilot").is_dir() or not (root / "pyproject.toml").is_file():
        return ""
    top = _git(root, "rev-parse", "--show-toplevel")
    if top is None or Path(top).resolve() != root.resolve():
        return ""
    head = _git(root, "rev-parse", f"--short={_HASH_DIGITS}", "HEAD")
    if head is None or _git(root, "ls-files", "--error-unmatch", "autopilot/__init__.py") is None:
        return ""
    changed = _git(root, "status", "--porcelain", "--", *_OURS)
    return head if changed == "" else f"{head}-dirty"


def _git(root: Path, *arguments: str) -> str | None:
    """Output of git in that folder, None when it fails. GIT_DIR and the like are ignored."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], env=environment, capture_output=True, text=True, check=False
        )
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
