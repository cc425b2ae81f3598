"""Whether the computer is quick enough: threads are told apart, and what is too slow is said with what can be done."""

import threading
import time

import pytest

from autopilot.analysis.nmpc_flight import control_load
from autopilot.core.messages import LoopStats
from autopilot.core.vehicle import load_vehicle
from autopilot.run.doctor_computer import MOST_LOAD, ServiceLoad, ThreadMeter, judge_load
from autopilot.run.findings import FindingSeverity

QUIET = ServiceLoad(whole=0.2, threads={"loop": 0.15, "vision": 0.05}, worst_tick_s=0.01)


def test_a_thread_that_works_is_told_by_its_name() -> None:
    meter, end = ThreadMeter(), threading.Event()

    def work() -> None:
        begin_s = time.thread_time()
        while time.thread_time() - begin_s < 0.2:
            pass
        end.wait()

    thread = threading.Thread(target=work, name="vision_0")
    thread.start()
    while meter.load().threads.get("vision", 0.0) == 0.0:
        end.wait(0.02)
    meter.note(LoopStats(t_us=0, tick_s=0.3, cpu_s=0.0, overruns=0, dropped_log=0))
    load = meter.load()
    end.set()
    thread.join()
    assert 0.0 < load.threads["vision"] <= load.whole + 0.05
    assert load.worst_tick_s == 0.3
    meter.start()
    assert meter.load().worst_tick_s == 0.0 and "vision" not in meter.load().threads


@pytest.mark.parametrize("name", ["lbv150", "bluerov2-heavy"])
def test_the_controller_flies_the_vehicle_at_hand(name: str) -> None:
    assert control_load(load_vehicle(name), 0) > 0.0


@pytest.mark.parametrize(
    ("flying", "cost", "verdict", "says", "remedy"),
    [
        ((0.1, 0.3), 1, FindingSeverity.OK, "both costs", ""),
        ((0.1, 0.6), 0, FindingSeverity.OK, "MPC_COST 0 only", ""),
        ((0.1, 0.6), 1, FindingSeverity.WARN, "MPC_COST 0 only", "set MPC_COST 0"),
        ((0.6, 0.9), 0, FindingSeverity.WARN, "neither cost", "camera rate_hz"),
    ],
)
def test_what_can_be_flown(
    flying: tuple[float, float], cost: int, verdict: FindingSeverity, says: str, remedy: str
) -> None:
    listens, flies = judge_load(QUIET, flying, cost, has_camera=True)
    assert listens.verdict is FindingSeverity.OK and "loop 0.15, vision 0.05" in listens.found
    assert flies.verdict is verdict and says in flies.found and f"within {MOST_LOAD:g}" in flies.found
    assert remedy in flies.remedy and bool(flies.remedy) == bool(remedy)


def test_a_loop_that_is_late_is_warned_of() -> None:
    late = ServiceLoad(whole=0.9, threads={"loop": 0.9}, worst_tick_s=0.2)
    listens, _ = judge_load(late, (0.1, 0.1), 0, has_camera=False)
    assert listens.verdict is FindingSeverity.WARN and "longest tick 200 ms" in listens.found and listens.remedy
