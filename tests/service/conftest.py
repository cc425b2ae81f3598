"""Fixtures of the service's tests."""

import pytest
from commander_bench import Bench


@pytest.fixture(name="bench")
def bench_fixture() -> Bench:
    return Bench()
