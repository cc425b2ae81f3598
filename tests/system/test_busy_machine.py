"""A service that gets no processor for a while: clients wait for it, and know when it is gone; its HEARTBEATs come by
the clock on the wall, as far as it gets to run at all."""

import contextlib
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from system_harness import RunningService

from autopilot.client.client_session import VehicleConnection
from autopilot.client.exchange import Timers
from autopilot.core.messages import MavlinkFrame, Outputs, ProgressState
from autopilot.core.own_python import python_command
from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl
from autopilot.run.transport import BEAT_S, _beat_of

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


NEIGHBOURS = 2
SLOW_TICK_S = 0.015
"""CPU time added to every tick: more than there is until the next one, on any machine."""
MOST_GAP_S = 1.2


@contextlib.contextmanager
def _busy_neighbours() -> Iterator[None]:
    """Processes that want the processor all the time."""
    busy = [subprocess.Popen(python_command("while True: pass")) for _ in range(NEIGHBOURS)]
    try:
        yield
    finally:
        for each in busy:
            each.kill()
            each.wait()


def test_heartbeats_keep_to_real_time_when_the_loop_does_not(tmp_path: Path) -> None:
    """A second of the vehicle takes longer than one of the wall's clock, which alone would space HEARTBEATs too far
    apart. No clock is assumed to be kept: a gap may be longer than the rule by what the loop was held at a stretch,
    between two looks at the clock, and no more."""

    def labour(_: Outputs) -> None:
        end_s = time.thread_time() + SLOW_TICK_S
        while time.thread_time() < end_s:
            pass

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client, _busy_neighbours():
        client.bind(("127.0.0.1", 0))
        settings = flight_settings(tmp_path / "state", {"speed": 1.0, "sensors": "pose", "duration": 2.0})
        settings.put("connect", (f"udpout:127.0.0.1:{client.getsockname()[1]}",), "test")
        session = open_sitl(settings, {}, log=False, on_tick=labour)
        runtime, looks, beats_s = session.runtime, list[tuple[float, float]](), list[float]()
        attend, send = runtime.attend, runtime._transport.send

        def attended() -> None:
            begin_s = time.monotonic()
            attend()
            looks.append((begin_s, time.monotonic()))

        def sent(frames: Sequence[MavlinkFrame]) -> None:
            send(frames)
            beats_s.extend([time.monotonic()] * any(_beat_of(frame) is not None for frame in frames))

        runtime.attend, runtime._transport.send = attended, sent  # type: ignore[method-assign]
        session.run()
        client.setblocking(False)
        assert client.recv(4096), "and they have left"
    assert len(looks) > runtime.counters.ticks == 200 and len(beats_s) > 1
    for last_s, next_s in pairwise(beats_s):
        between = [look for look in looks if look[1] >= last_s and look[0] <= next_s]
        held_s = max((after[1] - before[0] for before, after in pairwise(between)), default=0.0)
        assert next_s - last_s <= max(BEAT_S + held_s, MOST_GAP_S), f"{next_s - last_s:.2f} s, held {held_s:.2f} s"
