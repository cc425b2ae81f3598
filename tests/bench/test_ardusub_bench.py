"""The cases for a real ArduSub, on the emulated one: the rig stands and tells right from wrong."""

from pathlib import Path

import pytest

from tests.bench.ardusub import recording
from tests.bench.ardusub.__main__ import tried
from tests.bench.ardusub.cases import CASES, Bench, Case, must
from tests.bench.ardusub.recording import Outcome
from tests.bench.ardusub.rig import Below

RECORDED = recording.read()


@pytest.mark.parametrize("name", ["FS_PILOT_TIMEOUT 3", "lights by DO_SET_SERVO"])
def test_a_case_says_what_it_saw(tmp_path: Path, name: str) -> None:
    chosen = next(one for one in CASES if one.name == name)
    outcome = tried(chosen, Bench(folder=tmp_path, below=Below(program=None)))
    assert outcome.good, outcome.seen
    assert not recording.differences(name, outcome.figures, RECORDED)


def test_a_case_that_does_not_hold_is_told(tmp_path: Path) -> None:
    def run(_: object) -> str:
        must(False, "it turns")
        return ""

    bench = Bench(folder=tmp_path, below=Below(program=None))
    outcome = tried(Case(name="a", wanted="b", run=run), bench)
    assert outcome == Outcome(must="b", seen="it turns", good=False, figures={})
    assert len({one.name for one in CASES}) == len(CASES)


def test_every_case_is_recorded_and_what_differs_is_told() -> None:
    assert [one.name for one in CASES] == list(RECORDED.cases)
    killed = RECORDED.cases["service killed"].figures
    assert not recording.differences("service killed", killed, RECORDED)
    late = recording.differences("service killed", {"neutral after, s": killed["neutral after, s"] + 1.0}, RECORDED)
    assert len(late) == 1 and "tolerance" in late[0]
    assert recording.differences("service killed", {}, RECORDED)


def test_a_recording_is_read_as_it_was_written(tmp_path: Path) -> None:
    recording.write(tmp_path / "a.json", RECORDED)
    assert recording.read(tmp_path / "a.json") == RECORDED
