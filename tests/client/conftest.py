"""Hypothesis without deadlines: a slow machine is no error; and the link to a vehicle in this process."""

import pytest
from client_world import MemoryLink
from hypothesis import settings

settings.register_profile("patient", deadline=None)
settings.load_profile("patient")


@pytest.fixture(name="link")
def link_fixture() -> MemoryLink:
    return MemoryLink()
