"""What the processes of a pool are forked from."""

import subprocess
from pathlib import Path

from autopilot.run.children import python_command

CODE = """
import os, sys
import autopilot.campaign.worker
threads = len(os.listdir("/proc/self/task")) if os.path.isdir("/proc/self/task") else 1
from autopilot.campaign.definition import define
task = define("r1", duration_s=1.5).task(0)
before = set(sys.modules)
task.fly()
print(threads, sorted(set(sys.modules) - before))
"""


def test_it_has_all_that_a_run_imports_and_no_thread(tmp_path: Path) -> None:
    """Processes are forked from it: a thread's locks would be held for ever in them. A run imports nothing more."""
    done = subprocess.run(python_command(CODE), capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "1 []"
