"""Fixtures of the MAVLink tests."""

from collections.abc import Callable

import pytest
from mavlink_harness import Client, World

from autopilot.mavlink.api import CommandReply, CommandResult


@pytest.fixture(name="profile")
def profile_fixture() -> str:
    """Unless a test is parametrized by it."""
    return "px4"


@pytest.fixture(name="world")
def world_fixture(profile: str) -> World:
    return World(profile)


@pytest.fixture(name="client")
def client_fixture(world: World) -> Client:
    return world.client()


@pytest.fixture
def refuse() -> Callable[[World, str, str], None]:
    """Makes the vehicle refuse one kind of request with a reason."""

    def refuse_(world: World, name: str, reason: str) -> None:
        world.vehicle.answers[name] = CommandReply(result=CommandResult.DENIED, reason=reason)

    return refuse_
