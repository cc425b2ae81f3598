"""The pool by its markers, sheets half a metre apart, of which the camera sees one to three at a time."""

from pathlib import Path

from autopilot import fly


def test_pictures_of_few_markers_are_in_no_doubt(tmp_path: Path) -> None:
    """A sound camera was rejected where one marker had been seen before three."""
    log = fly("pool", sensors="camera", seed=4, duration_s=31.0, log=tmp_path / "run.mcap")
    used = log["/nav/fit"]["used"]
    assert used.min() == 1 and used.max() >= 3
    assert log["/nav/aid/markers"]["fused"].all()
    texts = [row.value["msg"] for row in log.messages("/rosout") if row.value["level"] >= 30]
    assert not texts, texts
