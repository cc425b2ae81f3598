"""Whether the computer is quick enough: threads are told apart, and what is too slow is said with what can be done."""

import threading
import time

import pytest

from autopilot.analysis.nmpc_flight import HORIZONS, FlightTrial, horizon_times
from autopilot.core.messages import LoopStats
from autopilot.core.vehicle import load_vehicle
from autopilot.run.doctor_computer import MOST_LOAD, FlightLoads, ServiceLoad, ThreadMeter, judge_load
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
    for _ in range(10):
        meter.tick(1)
    assert meter.load().pictures_hz == pytest.approx(100.0), "by the ticks taken, however long they took"


def flown(*totals: float, rate_hz: float = 10.0) -> FlightLoads:
    """Loads with MPC_COST 0, 1: pictures take 0.06 of a core, control steps 0.1."""
    quadratic, energy = (
        ServiceLoad(
            whole=total,
            threads={"loop": 0.25, "vision": 0.05, "camera": 0.01, "trajectories": 0.2},
            worst_tick_s=0.01,
            pictures_hz=rate_hz,
        )
        for total in totals
    )
    return FlightLoads(by_cost=(quadratic, energy), horizons={8.0: 1.0, 16.0: 2.0, 32.0: 4.0})


@pytest.mark.parametrize(("name", "cost"), [("lbv150", 1), ("bluerov2-heavy", 0)])
def test_the_controller_flies_the_vehicle_at_hand(name: str, cost: int) -> None:
    before = set(threading.enumerate())
    trial = FlightTrial(load_vehicle(name), cost)
    for _ in range(10):
        trial.step()
    mine = set(threading.enumerate()) - before
    trial.close()
    assert any(thread.name.startswith("routes") for thread in mine), "plans are made beside the loop, as in flight"
    for thread in mine:
        thread.join()


def test_longer_horizons_are_tried_from_the_controllers_own_on() -> None:
    times = horizon_times(load_vehicle("lbv150"))
    assert list(times) == sorted(HORIZONS) and times[8.0] == 1.0 and min(times.values()) > 0.0


@pytest.mark.parametrize(
    ("totals", "rate_hz", "says"),
    [
        ((0.3, 0.39), 10.0, ("MPC_COST 0: 30 Hz or horizon 32 s", "MPC_COST 1: 30 Hz or horizon 32 s")),
        ((0.5, 0.59), 10.0, ("MPC_COST 0: 30 Hz or horizon 16 s", "MPC_COST 1: 20 Hz or horizon 16 s")),
        ((0.65, 0.72), 10.0, ("MPC_COST 0: 15 Hz or horizon 8 s", "MPC_COST 1: 5 Hz")),
        ((0.65, 0.9), 10.0, ("MPC_COST 0: 15 Hz or horizon 8 s", "MPC_COST 1: nothing")),
        ((0.65, 0.9), 0.0, ("MPC_COST 0: horizon 8 s", "MPC_COST 1: nothing")),
    ],
)
def test_the_most_that_fits_is_told_by_cost(totals: tuple[float, float], rate_hz: float, says: tuple[str, str]) -> None:
    *_, most = judge_load(QUIET, flown(*totals, rate_hz=rate_hz), 0)
    assert most.found.startswith("; ".join(says) + " (") and "control step 5.0 ms, energy plans 0.20" in most.found
    assert ("picture 6.0 ms, " in most.found) is bool(rate_hz)


@pytest.mark.parametrize(
    ("totals", "cost", "verdict", "says", "remedy"),
    [
        ((0.3, 0.5), 1, FindingSeverity.OK, "both costs", ""),
        ((0.3, 0.8), 0, FindingSeverity.OK, "MPC_COST 0 only", ""),
        ((0.3, 0.8), 1, FindingSeverity.WARN, "MPC_COST 0 only", "set MPC_COST 0"),
        ((0.8, 1.1), 0, FindingSeverity.WARN, "neither cost", "camera rate_hz"),
    ],
)
def test_what_can_be_flown(
    totals: tuple[float, float], cost: int, verdict: FindingSeverity, says: str, remedy: str
) -> None:
    listens, flies, _ = judge_load(QUIET, flown(*totals), cost)
    assert listens.verdict is FindingSeverity.OK and "loop 0.15, vision 0.05" in listens.found
    assert flies.verdict is verdict and says in flies.found and f"within {MOST_LOAD:g}" in flies.found
    assert remedy in flies.remedy and bool(flies.remedy) == bool(remedy)


def test_a_loop_that_is_late_is_warned_of() -> None:
    late = ServiceLoad(whole=0.9, threads={"loop": 0.9}, worst_tick_s=0.2)
    listens, *_ = judge_load(late, flown(0.3, 0.3), 0)
    assert listens.verdict is FindingSeverity.WARN and "longest tick 200 ms" in listens.found and listens.remedy
