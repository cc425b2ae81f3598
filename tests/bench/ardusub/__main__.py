"""``python -m tests.bench.ardusub --ardusub PATH``: every case with a real ArduSub, as one table.

PATH is ArduSub's program for simulation, built from its sources (``./waf configure --board sitl; ./waf sub``);
without it the emulated one is flown and its figures are held against the recorded ones. Real time, about half a minute
a case. ``--record`` keeps what was seen, from which ``docs/ardusub_page.py --write`` writes the table of hardware.md.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.bench.ardusub import recording
from tests.bench.ardusub.cases import CASES, Bench, Case
from tests.bench.ardusub.recording import Outcome, Recording
from tests.bench.ardusub.rig import Below


def tried(case: Case, bench: Bench) -> Outcome:
    try:
        good, seen = True, case.run(bench)
    except (AssertionError, OSError, RuntimeError, ValueError, subprocess.SubprocessError) as problem:
        good, seen = False, str(problem)
    figures = {name: value for rig in bench.made for name, value in rig.figures.items()}
    return Outcome(must=case.wanted, seen=seen, good=good, figures=figures)


def _kept(path: Path, ardusub: str, outcomes: dict[str, Outcome]) -> None:
    """Cases that were not flown now keep what is recorded of them, with the same ArduSub."""
    before = recording.read(path) if path.is_file() else Recording(ardusub=ardusub, cases={})
    known = before.cases if before.ardusub == ardusub else {}
    both = {**known, **outcomes}
    recording.write(
        path, Recording(ardusub=ardusub, cases={one.name: both[one.name] for one in CASES if one.name in both})
    )


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--ardusub", type=Path, help="ArduSub's program for simulation; without: the emulated one")
    options.add_argument("--only", default="", help="cases with one of these in their name, separated by /")
    options.add_argument("--keep", type=Path, help="folder for logs and outputs, default: none are kept")
    options.add_argument("--record", nargs="?", type=Path, const=recording.RECORDING, help="file for what was seen")
    given = options.parse_args()
    below = Below(program=None if given.ardusub is None else given.ardusub.resolve())
    chosen = [
        one
        for one in CASES
        if any(part in one.name for part in given.only.split("/")) and not (one.real_only and below.program is None)
    ]
    outcomes: dict[str, Outcome] = {}
    differences: list[str] = []
    known = recording.read() if below.program is None and recording.RECORDING.is_file() else None
    ardusub = ""
    print(f"| {below.name}: case | must | seen | |\n| --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as temporary:
        for one in chosen:
            begin_s = time.monotonic()
            folder = (given.keep or Path(temporary)).resolve() / f"{CASES.index(one)}"
            bench = Bench(folder=folder, below=below)
            seen = outcomes[one.name] = tried(one, bench)
            ardusub = next((rig.version for rig in bench.made if rig.version), ardusub)
            print(f"| {one.name} | {one.wanted} | {seen.seen} | {'ok' if seen.good else '**NO**'} |", flush=True)
            print(f"{time.monotonic() - begin_s:.0f} s, {seen.figures}", file=sys.stderr, flush=True)
            if known is not None and one.name in known.cases:
                differences += recording.differences(one.name, seen.figures, known)
            if given.record is not None:
                _kept(given.record, ardusub or below.name, outcomes)
    bad = sum(not seen.good for seen in outcomes.values())
    print(f"\n{ardusub}: {len(chosen) - bad} of {len(chosen)} cases", *differences, sep="\n")
    return 1 if bad or differences else 0


if __name__ == "__main__":
    sys.exit(main())
