"""CPU time per tick of two revisions in turns: what a change costs on this machine, whatever else the machine does.

The older revision is checked out beside this one and its library is compiled; then both fly the same missions by
turns, each in a process of its own.
"""

import io
import json
import subprocess
import tarfile
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from autopilot.core.errors import AutopilotError
from autopilot.core.own_python import python_command

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ("tick_mean_ms", "step_median_ms", "cpu_s_per_s")
"""Of the rows of ``autopilot bench sitl``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnsRow:
    """One figure of one flight: medians over the turns, and the median of their ratios."""

    flight: str
    figure: str
    base: float
    here: float
    ratio: float
    least: float
    most: float
    """Of the ratios."""


def base_revision() -> str:
    """Where the present revision departed from origin/main; the one before it where it is that branch itself."""
    here, branch = _git("rev-parse", "HEAD"), _git("branch", "--remotes", "--list", "origin/main")
    departed = _git("merge-base", "HEAD", "origin/main") if branch else here
    return _git("rev-parse", "HEAD~1") if departed == here else departed


def bench_turns(revision: str, turns: int) -> list[TurnsRow]:
    """``revision`` against this tree, as many ``turns`` each."""
    found: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    with _checked_out(revision) as base:
        for _ in range(turns):
            before, now = _rows(base), _rows(ROOT)
            for flight in before.keys() & now.keys():
                for figure in FIGURES:
                    found[flight, figure].append((before[flight][figure], now[flight][figure]))
    return [_row(flight, figure, np.array(pairs)) for (flight, figure), pairs in sorted(found.items())]


def _row(flight: str, figure: str, pairs: np.ndarray) -> TurnsRow:
    ratios = pairs[:, 1] / pairs[:, 0]
    base, here = np.median(pairs, axis=0).tolist()
    return TurnsRow(
        flight=flight,
        figure=figure,
        base=base,
        here=here,
        ratio=float(np.median(ratios)),
        least=float(ratios.min()),
        most=float(ratios.max()),
    )


def _rows(tree: Path) -> dict[str, dict[str, float]]:
    """Rows of ``bench sitl --short`` of a tree, by flight; exit code 1 only says that a bar is missed."""
    code = "from autopilot.cli.main import main; sys.argv[1:] = ['bench', 'sitl', '--short', '--json']; main()"
    command = python_command(code, tree)
    done = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1) or not done.stdout.strip():
        raise AutopilotError(f"the benchmark of {tree} failed: {done.stderr.strip()[-300:]}")
    rows = json.loads(done.stdout)["sitl"]["rows"]
    return {f"{row['sensors']}, {row.get('cost', 'energy')}": row for row in rows}


@contextmanager
def _checked_out(revision: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        with tarfile.open(fileobj=io.BytesIO(_git_bytes("archive", revision))) as files:
            files.extractall(tree, filter="tar")
        code = "__file__ = 'setup.py'; sys.argv = [__file__, 'build_ext', '--inplace']; exec(open(__file__).read())"
        subprocess.run(python_command(code, tree), cwd=tree, check=True, capture_output=True)
        yield tree


def _git(*arguments: str) -> str:
    return _git_bytes(*arguments).decode().strip()


def _git_bytes(*arguments: str) -> bytes:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, check=False)
    if done.returncode:
        raise AutopilotError(f"git {' '.join(arguments)}: {done.stderr.decode().strip()}")
    return done.stdout
