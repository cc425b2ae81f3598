"""Linear algebra takes one thread: threads that spin while others work make ticks late."""

import os
import subprocess
import sys

import pytest

from autopilot import THREAD_VARIABLES

COUNT = """
import autopilot
import numpy as np
a = np.random.default_rng(1).random((600, 600))
for _ in range(5):
    np.linalg.solve(a, a)
print(len(__import__("os").listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="threads are counted in /proc")
def test_linear_algebra_starts_no_threads_unless_told() -> None:
    bare = {name: value for name, value in os.environ.items() if name not in THREAD_VARIABLES}
    done = subprocess.run([sys.executable, "-c", COUNT], env=bare, capture_output=True, text=True, check=True)
    assert int(done.stdout) == 1
    asked = subprocess.run(
        [sys.executable, "-c", "import os, autopilot; print(os.environ['OPENBLAS_NUM_THREADS'])"],
        env={**bare, "OPENBLAS_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert asked.stdout.strip() == "2"
