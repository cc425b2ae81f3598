"""How many small changes of meaning the tests notice: ``python -m tests.mutate --seed 1 --places 200``.

Picks places of our packages by a seed, makes one change at a time in a copy of the tree, and runs the tests that are
nearest to the changed module until one fails. Places that mean the same are listed with the reason in
``tests/equivalent_mutations.txt`` (the line that a missed place is printed with, and `` | reason``). Exit code 1 when
fewer than 85 % of the others are noticed.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.mutation_places import Place, modules, places_of
from tests.mutation_tests import TestMap

ROOT = Path(__file__).resolve().parents[1]
EQUIVALENT = Path(__file__).with_name("equivalent_mutations.txt")
GOAL = 0.85


def equivalents() -> dict[str, str]:
    """Reason by the key of a place."""
    rows = [row for row in EQUIVALENT.read_text(encoding="utf-8").splitlines() if row and not row.startswith("#")]
    return {" | ".join(row.split(" | ")[:3]): row.split(" | ")[3] for row in rows}


def picked(seed: int, count: int, under: list[str]) -> list[Place]:
    """So many places, one as likely as another; in these folders alone, if there are any."""
    chosen = [path for path in modules(ROOT) if not under or any(str(path).startswith(start) for start in under)]
    every = [place for path in chosen for place in places_of(ROOT, path)]
    return random.Random(seed).sample(every, min(count, len(every)))


class Copy:
    """A copy of the tree, the installed library in it, in which one file is changed and changed back."""

    def __init__(self, folder: Path, seconds: float, trusted: bool) -> None:
        self._root, self._seconds, self._now, self._trusted = folder / "tree", seconds, 0, trusted
        names = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
        built = [str(path.relative_to(ROOT)) for path in (ROOT / "autopilot" / "core").glob("_compiled*")]
        for name in [*names.splitlines(), *built]:
            (self._root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, self._root / name, follow_symlinks=False)
        self._passing: dict[Path, bool] = {}

    def write(self, path: Path, source: bytes) -> None:
        """Another content: with a time of its own, else compiled code of the last one would be taken for it."""
        target = (self._root / path).resolve()
        target.write_bytes(source)
        self._now += 2
        os.utime(target, (1_500_000_000 + self._now,) * 2)

    def passes(self, test: Path) -> bool | None:
        """Whether a test module passes; None when it does not end in time."""
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:randomly", str(test)]
        env = os.environ | {"PYTHONPATH": str(self._root)}
        try:
            done = subprocess.run(
                command, cwd=self._root, env=env, timeout=self._seconds, capture_output=True, check=False
            )
        except subprocess.TimeoutExpired:
            return None
        return done.returncode == 0

    def passing(self, test: Path) -> bool:
        """Whether it passes without a change: else it says nothing. Asked before the change is made."""
        if test not in self._passing:
            self._passing[test] = self._trusted or bool(self.passes(test))
        return self._passing[test]


LATE = "not in time"


def verdict(copy: Copy, place: Place, tests: list[Path]) -> str:
    """Which test noticed, "" when none did, LATE when none did and one did not end."""
    passing = [test for test in tests if copy.passing(test)]
    source = (ROOT / place.path).read_bytes()
    copy.write(place.path, place.applied(source))
    try:
        late = False
        for test in passing:
            passed = copy.passes(test)
            if passed is False:
                return str(test)
            late = late or passed is None
    finally:
        copy.write(place.path, source)
    return LATE if late else ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--places", type=int, default=200)
    parser.add_argument("--under", nargs="*", default=[], help="only in these folders, as autopilot/core")
    parser.add_argument("--first", type=int, default=0, help="begin with this one of them")
    parser.add_argument("--most", type=int, default=None, help="stop after so many")
    parser.add_argument("--tests", type=int, default=6, help="test modules that are asked per place")
    parser.add_argument("--seconds", type=float, default=300.0, help="for one test module")
    parser.add_argument("--trusted", action="store_true", help="tests pass without a change: do not ask")
    parser.add_argument("--list", action="store_true", help="only say what would be changed, and what is asked")
    args = parser.parse_args()
    places, known, tests = picked(args.seed, args.places, args.under), equivalents(), TestMap(ROOT)
    places = places[args.first :][: args.most]
    if args.list:
        for place in places:
            print(place.name, "|", " ".join(map(str, tests.ranked(place.path)[: args.tests])))
        return 0
    noticed, missed, same, late = 0, 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder), args.seconds, args.trusted)
        for place in places:
            key = place.key((ROOT / place.path).read_bytes())
            if key in known:
                same += 1
                print(f"same     {place.name} ({known[key]})", flush=True)
                continue
            by = verdict(copy, place, tests.ranked(place.path)[: args.tests])
            if by == LATE:
                late += 1
                print(f"LATE     {place.name}: give it more --seconds", flush=True)
                continue
            noticed, missed = noticed + bool(by), missed + (not by)
            print(f"noticed  {place.name} by {by}" if by else f"MISSED   {place.name}\n         {key}", flush=True)
    caught = noticed / max(noticed + missed, 1)
    print(
        f"{noticed} of {noticed + missed} noticed ({caught:.0%}), {same} equivalent, {late} not known; goal {GOAL:.0%}"
    )
    return 0 if caught >= GOAL and not late else 1


if __name__ == "__main__":
    sys.exit(main())
