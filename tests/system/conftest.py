"""The whole service, in this process with virtual time or as a process of its own."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from system_harness import OpenSession, RunningService

from autopilot.core.messages import Outputs
from autopilot.run.children import Child, autopilot_command, free_port
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl


@contextlib.contextmanager
def sessions(folder: Path) -> Iterator[OpenSession]:
    """Makes sessions with nothing shared: no sockets, a state folder of their own, lockstep."""
    opened: list[SitlSession] = []

    def make(
        scenario: str = "paper-tank",
        *,
        peers: Sequence[Any] = (),
        params: dict[str, float] | None = None,
        log: Path | None = None,
        on_tick: Callable[[Outputs], None] = lambda _: None,
        **given: Any,
    ) -> SitlSession:
        settings = flight_settings(folder / "state", {"scenario": scenario, **given})
        settings.put("log", None if log is None else str(log), "test")
        made = open_sitl(settings, params or {}, log=log is not None, peers=peers, on_tick=on_tick)
        opened.append(made)
        return made

    yield make
    for made in opened:
        made.runtime.close()
        made.recorder.close()


@pytest.fixture
def session(tmp_path: Path) -> Iterator[OpenSession]:
    """Sessions of a test."""
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
