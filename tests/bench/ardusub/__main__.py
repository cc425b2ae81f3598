"""``python -m tests.bench.ardusub --ardusub PATH``: every case with a real ArduSub, as one table.

PATH is ArduSub's program for simulation, built from its sources (``./waf configure --board sitl; ./waf sub``);
without it the emulated one is flown. Real time, about half a minute a case.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.bench.ardusub.cases import CASES, Bench, Case
from tests.bench.ardusub.rig import Below


def tried(case: Case, below: Below, folder: Path) -> tuple[bool, str]:
    try:
        return True, case.run(Bench(folder=folder, below=below))
    except (AssertionError, OSError, RuntimeError, subprocess.SubprocessError) as problem:
        return False, str(problem)


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--ardusub", type=Path, help="ArduSub's program for simulation; without: the emulated one")
    options.add_argument("--only", default="", help="cases with this in their name")
    options.add_argument("--keep", type=Path, help="folder for logs and outputs, default: none are kept")
    given = options.parse_args()
    below = Below(program=None if given.ardusub is None else given.ardusub.resolve())
    chosen = [one for one in CASES if given.only in one.name and not (one.real_only and below.program is None)]
    bad = 0
    print(f"| {below.name}: case | must | seen | |\n| --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as temporary:
        for number, one in enumerate(chosen):
            begin_s = time.monotonic()
            good, seen = tried(one, below, (given.keep or Path(temporary)).resolve() / f"{number}")
            bad += not good
            print(f"| {one.name} | {one.wanted} | {seen} | {'ok' if good else '**NO**'} |", flush=True)
            print(f"{time.monotonic() - begin_s:.0f} s", file=sys.stderr)
    print(f"\n{len(chosen) - bad} of {len(chosen)} cases")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
