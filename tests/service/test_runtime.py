"""The loop: order of things, late ticks, stopping."""

import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from autopilot.core.marks import LoopPart, ServiceThread, TickTimer
from autopilot.core.messages import Inputs, LoopStats, MavlinkFrame, ModeState, Outputs, ThrusterCommand
from autopilot.core.samples import CameraFrame, Sample
from autopilot.drivers.protocols import Received
from autopilot.run.clocks import LockstepClock
from autopilot.run.loop_account import ThreadTimes
from autopilot.run.runtime import Runtime


class Service:
    """Answers every tick with one frame to all links."""

    nav = None

    def __init__(self) -> None:
        self.inputs: list[Inputs] = []

    def step(self, inputs: Inputs) -> Outputs:
        self.inputs.append(inputs)
        return Outputs(
            t_us=inputs.t_us,
            command=ThrusterCommand(t_us=inputs.t_us, thrust_n=np.zeros(8), pwm_us=(1500,) * 8),
            nav=None,
            mode=ModeState(t_us=inputs.t_us, armed=False, custom_mode=0, failsafes=0),
            mavlink_tx=(MavlinkFrame(link=-1, data=b"all"), MavlinkFrame(link=1, data=b"second")),
        )


class Device:
    def __init__(self) -> None:
        self.calls: list[str] = []

    def advance(self, t_us: int) -> None:
        self.calls.append("advance")

    def poll(self, t_us: int) -> Sequence[Sample]:
        self.calls.append("poll")
        return ()

    def frames(self, t_us: int) -> Sequence[CameraFrame]:
        return ()

    def write(self, t_us: int, command: ThrusterCommand) -> None:
        self.calls.append("write")

    def close(self) -> None:
        self.calls.append("close")


class Link:
    name = "memory"
    problem = None
    dropped_tx = 0

    def __init__(self) -> None:
        self.inbox: list[bytes] = []
        self.sent: list[bytes] = []
        self.closed = False

    def recv(self, t_us: int) -> list[Received]:
        received, self.inbox = self.inbox, []
        return [Received(data, 7, "memory") for data in received]

    def send(self, data: bytes, client: int = 0) -> None:
        self.sent.append(data)

    def filenos(self) -> list[int]:
        return []

    def close(self) -> None:
        self.closed = True


class Recorder:
    dropped = 3
    queued = (0, 0)
    lost = False

    def __init__(self) -> None:
        self.stats: list[LoopStats] = []

    def record(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        pass

    def loop_stats(self, stats: LoopStats) -> None:
        self.stats.append(stats)


class LateClock(LockstepClock):
    """Every tenth tick begins 15 ms late."""

    def wait_until(self, t_us: int) -> int:
        super().wait_until(t_us)
        return t_us + (15_000 if t_us % 100_000 == 0 else 500)


def _runtime(clock: Any = None, links: Sequence[Link] = ()) -> tuple[Runtime, Service, Device, Recorder]:
    service, device, recorder = Service(), Device(), Recorder()
    runtime = Runtime(service, device, None, links, recorder, clock or LockstepClock())  # type: ignore[arg-type]
    return runtime, service, device, recorder


def test_a_tick_goes_from_world_to_thrusters_and_closing_is_last() -> None:
    runtime, service, device, _ = _runtime()
    runtime.run(duration_s=0.02, stop=lambda: False)
    assert device.calls == ["advance", "poll", "write", "advance", "poll", "write", "close"]
    assert [inputs.t_us for inputs in service.inputs] == [10_000, 20_000]


def test_late_ticks_are_counted_logged_and_told_to_the_service() -> None:
    runtime, service, _, recorder = _runtime(LateClock())
    runtime.run(duration_s=2.0, stop=lambda: False)
    assert runtime.counters.overruns == 20
    assert [stats.overruns for stats in recorder.stats] == [10, 20]
    assert service.inputs[-1].overruns == 20
    assert recorder.stats[0].dropped_log == 3


def test_lockstep_is_never_late() -> None:
    runtime, *_ = _runtime()
    runtime.run(duration_s=1.0, stop=lambda: False)
    assert runtime.counters.overruns == 0


def test_the_loop_names_the_part_that_made_a_tick_late() -> None:
    """Each part in turn takes 50 ms of the 30th tick of its second."""
    now_s = [0.0]

    def slow(*_: Any, **__: Any) -> Any:
        if len(service.inputs) % 100 == 30:
            now_s[0] += 0.05
        return ()

    link = Link()
    runtime, service, device, recorder = _runtime(links=[link])
    watch = runtime.watch = TickTimer(wall_s=lambda: now_s[0], cpu_s=lambda: 0.0)
    service.marks = watch  # type: ignore[attr-defined]
    places: dict[LoopPart, tuple[Any, str]] = {
        LoopPart.DEVICE: (device, "poll"),
        LoopPart.RECEIVE: (runtime, "_receive"),
        LoopPart.WRITE: (device, "write"),
        LoopPart.SEND: (runtime, "_send"),
        LoopPart.RECORD: (recorder, "record"),
    }
    for tick, (part, (owner, name)) in enumerate(places.items()):
        whole = getattr(owner, name)
        setattr(owner, name, slow)
        for k in range(100):
            runtime.tick((100 * tick + k + 1) * 10_000)
        setattr(owner, name, whole)
        assert recorder.stats[-1].late_part is part
        assert recorder.stats[-1].part_s[part] == pytest.approx(0.05)
        assert recorder.stats[-1].tick_s == pytest.approx(0.05)
        assert sorted(recorder.stats[-1].ticks_s) == pytest.approx([0.0] * 99 + [0.05])
        assert len(recorder.stats[-1].ticks_cpu_s) == 100


def test_frames_reach_their_links() -> None:
    links = [Link(), Link()]
    links[1].inbox = [b"hello"]
    runtime, service, *_ = _runtime(links=links)
    runtime.run(duration_s=0.01, stop=lambda: False)
    assert links[0].sent == [b"all"]
    assert links[1].sent == [b"all", b"second"]
    (came,) = service.inputs[0].mavlink_rx
    assert (came.link, came.client, came.sender, came.data) == (1, 7, "memory", b"hello")
    assert all(link.closed for link in links)


def test_thrusters_go_neutral_when_the_service_fails() -> None:
    runtime, service, device, _ = _runtime()

    def fail(_: Inputs) -> Outputs:
        raise RuntimeError("bug")

    runtime.wrap_step(fail)
    with pytest.raises(RuntimeError):
        runtime.run(duration_s=1.0, stop=lambda: False)
    assert device.calls[-1] == "close"
    assert service.inputs == []


def test_that_the_cpu_clock_is_read_after_long_parts_only() -> None:
    now_s, cpu_s, asked = [0.0], [0.0], [0]

    def cpu() -> float:
        asked[0] += 1
        return cpu_s[0]

    watch = TickTimer(wall_s=lambda: now_s[0], cpu_s=cpu)
    watch.begin(0.0)
    begun = asked[0]
    for part, took_s, busy_s in (
        (LoopPart.DEVICE, 0.0001, 0.0001),
        (LoopPart.ESTIMATE, 0.0200, 0.0040),  # had to wait for the processor
        (LoopPart.CONTROL, 0.0004, 0.0004),
    ):
        now_s[0] += took_s
        cpu_s[0] += busy_s
        watch.mark(part)
        assert watch.part_s[part] == pytest.approx(took_s)
        assert watch.part_cpu_s[part] == pytest.approx(busy_s)
    assert asked[0] == begun + 1


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel's clocks of threads")
def test_the_cpu_time_of_threads_is_told_apart() -> None:
    ended, times = threading.Event(), ThreadTimes()

    def work() -> None:
        begin_s = time.thread_time()
        while time.thread_time() - begin_s < 0.05:
            pass
        ended.wait()

    threads = [threading.Thread(target=work, name=name) for name in ("vision_0", "view http", "trajectories_0")]
    for thread in threads:
        thread.start()
    taken_s = np.array(times.take(0.0))
    while not taken_s[[ServiceThread.VISION, ServiceThread.VIEW, ServiceThread.TRAJECTORIES]].min() >= 0.05:
        taken_s += times.take(0.05)
    ended.set()
    for thread in threads:
        thread.join()
    # Threads that earlier tests leave behind end in their own time.
    assert taken_s[ServiceThread.LOOP] > 0.0 and taken_s[ServiceThread.LOG] < 0.05
    left_s = times.take(100.0)
    assert sum(left_s) == pytest.approx(100.0) and left_s[ServiceThread.OTHER] > 50.0, "what is left of the process"
