"""The bench's transfers over a bad link, a few of them."""

from tests.bench.faults.exchange import transfers


def test_uploads_over_a_bad_link_are_taken_as_sent() -> None:
    assert transfers(15, 12, 7) == 15
