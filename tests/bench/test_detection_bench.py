"""The campaign of false ids, a few pictures of each kind."""

import numpy as np
import pytest

from tests.bench.detection import bench_detection, totals
from tests.bench.photographs import PHOTOGRAPHS, read_photographs, shown, taken_again


@pytest.mark.long
def test_nothing_is_imagined_and_little_missed() -> None:
    rows = list(bench_detection(26, 5, floors=("DICT_4X4_1000", "DICT_APRILTAG_36h11")))
    assert len(rows) == 13
    assert sum(row.frames for row in rows) >= 26
    assert totals(rows).false_ids + totals(rows).blind_false_ids == 0
    assert totals(rows).frames == sum(row.frames for row in rows)
    assert sum(row.found for row in rows) > sum(row.opencv for row in rows)
    floors = rows[:2]
    assert sum(row.found for row in floors) >= 0.98 * sum(row.shown for row in floors)


def test_a_photograph_taken_again_has_its_markers_where_it_says() -> None:
    """Where OpenCV reads a marker in the new picture, it is at the place to which the old one's corners were moved."""
    photo = next(read_photographs(PHOTOGRAPHS))
    again = taken_again(photo, np.random.default_rng(3))
    ids, quads = shown(again.image, again.dictionary)
    assert len(ids) > 0
    for marker_id, quad in zip(ids, quads, strict=True):
        there = again.quads[again.ids == marker_id][0]
        assert np.abs(quad - there).max() < 3.0
