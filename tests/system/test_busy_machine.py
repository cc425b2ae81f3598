"""A service that gets no processor for a while: clients wait for it, and know when it is gone."""

import signal
import threading
from collections.abc import Callable, Iterator

import pytest
from system_harness import RunningService

from autopilot.client.client_session import VehicleConnection
from autopilot.client.exchange import Timers
from autopilot.core.errors import AutopilotError
from autopilot.core.messages import ProgressState
from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan

IMPATIENT = Timers(give_up_s=1.0)
HELD_S = 3.0


@pytest.fixture
def running(service: Callable[..., RunningService]) -> Iterator[RunningService]:
    made = service(speed=1.0)
    yield made
    if made.child.process.poll() is None:
        made.child.process.send_signal(signal.SIGCONT)


def _hold(running: RunningService) -> threading.Timer:
    """Stop the process, and let it go on after a while."""
    running.child.process.send_signal(signal.SIGSTOP)
    waker = threading.Timer(HELD_S, running.child.process.send_signal, (signal.SIGCONT,))
    waker.start()
    return waker


def test_exchanges_and_watching_outlast_a_service_that_is_held(running: RunningService) -> None:
    with VehicleConnection(f"udpout:127.0.0.1:{running.port}", IMPATIENT, at_work=running.child.at_work) as session:
        session.connect(1.0)
        plan = paper_plan(1)
        for kind in (PlanKind.FENCE, PlanKind.MISSION):
            waker = _hold(running)
            session.upload(kind, plan.items(kind))
            waker.join()
        waker = _hold(running)
        status = session.watch_mission(silence_s=1.0)
        waker.join()
        assert not status.armed
        assert status.state is not ProgressState.COMPLETE


def test_a_service_that_has_ended_is_named_at_once(service: Callable[..., RunningService]) -> None:
    running = service("--duration", "1.0")
    with (
        pytest.raises(AutopilotError, match="the service ended with exit code 0"),
        VehicleConnection(f"udpout:127.0.0.1:{running.port}", at_work=running.child.at_work) as session,
    ):
        session.connect()
        while True:
            session.poll(0.1)
