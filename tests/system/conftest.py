"""The whole service, in this process with virtual time or as a process of its own."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from system_harness import OpenSession, RunningService, sessions

from autopilot.run.children import Child, autopilot_command, free_port


@pytest.fixture
def session(tmp_path: Path) -> Iterator[OpenSession]:
    with sessions(tmp_path) as make:
        yield make


@pytest.fixture(scope="module")
def module_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[OpenSession]:
    """Sessions of flights that several tests of a module look at."""
    with sessions(tmp_path_factory.mktemp("flights")) as make:
        yield make


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Callable[..., RunningService]]:
    """Starts services; they are ended by SIGTERM and must end well."""
    with contextlib.ExitStack() as stack:

        def start(*arguments: str, scenario: str = "paper-tank", speed: float = 0.0) -> RunningService:
            port, log = free_port(), tmp_path / "service.mcap"
            command = autopilot_command(
                *("sitl", scenario, "--quiet", "--sensors", "pose", "--speed", str(speed), "--log", str(log)),
                *("--connect", f"udpin:127.0.0.1:{port}", *arguments),
            )
            child = Child(command, {"AUTOPILOT_STATE_DIR": str(tmp_path / "state")})

            def end() -> None:
                assert child.end() == 0

            stack.callback(end)
            return RunningService(child=child, port=port, log=log)

        yield start
