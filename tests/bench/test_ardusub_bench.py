"""The cases for a real ArduSub, on the emulated one: the rig stands and tells right from wrong."""

from pathlib import Path

import pytest

from tests.bench.ardusub.__main__ import tried
from tests.bench.ardusub.cases import CASES, Case, must
from tests.bench.ardusub.rig import Below


@pytest.mark.parametrize("name", ["FS_PILOT_TIMEOUT 3", "lights: DO_SET_SERVO to the autopilot"])
def test_a_case_says_what_it_saw(tmp_path: Path, name: str) -> None:
    chosen = next(one for one in CASES if one.name == name)
    good, seen = tried(chosen, Below(program=None), tmp_path)
    assert good, seen


def test_a_case_that_does_not_hold_is_told(tmp_path: Path) -> None:
    def run(_: object) -> str:
        must(False, "it turns")
        return ""

    assert tried(Case(name="a", wanted="b", run=run), Below(program=None), tmp_path) == (False, "it turns")
    assert len({one.name for one in CASES}) == len(CASES)
