"""A service's memory: bounded whatever clients send, gone when the service has gone, and given back to the system."""

import ctypes
import gc
import subprocess
import sys
import threading
import weakref
from pathlib import Path

import numpy as np
import pytest
from held import tables

from autopilot.core.daemon_executor import DaemonExecutor
from autopilot.core.messages import MavlinkFrame
from autopilot.run.session import LARGE_BYTES
from tests.bench.fuzz.fuzzer import Fuzzer
from tests.bench.fuzz.messages import Sender, Traffic

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

PER_TICK = 25
TICKS = 60
MOST = 2_100
"""No table is longer: as many items as a plan may have. What is there for each client, sender or text has less."""


class Crowd(Traffic):
    """Strangers without end: other ids, another address and MAVLink 1 at every turn."""

    def next(self) -> MavlinkFrame:
        rng = self._rng
        self._senders = tuple(
            Sender(
                rng.randrange(1, 256),
                rng.randrange(256),
                link=rng.randrange(3),
                client=rng.randrange(1, 1 << 20),
                old=rng.random() < 0.3,
            )
            for _ in range(2)
        )
        self._talker = self._senders[0]
        return self.frame()


def flood(fuzzer: Fuzzer, crowd: Crowd) -> dict[str, int]:
    for _ in range(TICKS):
        fuzzer.step([crowd.next() for _ in range(PER_TICK)], wild=False)
    gc.collect()
    return tables(fuzzer._service, without=(fuzzer._observer, fuzzer.session.device))


def test_a_crowd_without_end_fills_no_table(tmp_path: Path) -> None:
    """Thousands of senders, addresses, vehicles, texts and questions: every table of the service keeps to a size."""
    fuzzer = Fuzzer(3, tmp_path)
    try:
        fuzzer._calm()
        crowd = Crowd(5)
        flood(fuzzer, crowd)
        early, late = flood(fuzzer, crowd), flood(fuzzer, crowd)
    finally:
        fuzzer.close()
    assert fuzzer.result.messages > 3 * TICKS * PER_TICK - 1
    grown = {path: (early.get(path, 0), size) for path, size in late.items() if size > early.get(path, 0) + 300}
    assert not grown
    assert {path: size for path, size in late.items() if size > MOST} == {}


@pytest.mark.parametrize("signed", [False, True])
def test_a_closed_service_is_garbage(tmp_path: Path, *, signed: bool) -> None:
    """Its threads had gone on, and held it with all its solvers: 40 MB for each."""
    before = set(threading.enumerate())
    fuzzer = Fuzzer(1, tmp_path, signed=signed)
    fuzzer._calm()
    parts = fuzzer.session.parts
    held = [
        weakref.ref(part) for part in (fuzzer._service, parts.server, parts.controller, parts.estimator, parts.plans)
    ]
    fuzzer.close()
    for thread in set(threading.enumerate()) - before:
        thread.join(60.0)
        assert not thread.is_alive(), thread.name
    del fuzzer, parts
    gc.collect()
    assert [part() for part in held] == [None] * len(held)


class Work:
    """Something to be done."""

    def __call__(self) -> str:
        return "done"


def test_an_idle_lane_keeps_nothing_of_what_it_did_last() -> None:
    executor = DaemonExecutor("test")
    work = Work()
    there = weakref.ref(work)
    assert executor.submit(work).result(60.0) == "done"
    assert executor.submit(lambda: None).result(60.0) is None  # the first job has been laid down
    del work
    gc.collect()
    assert there() is None
    thread = executor._thread
    del executor
    gc.collect()
    thread.join(60.0)
    assert not thread.is_alive()


class _Figures(ctypes.Structure):
    """glibc's struct mallinfo2."""

    _names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in _names.split()]


LIBRARY = ctypes.CDLL(None)


@pytest.mark.skipif(not hasattr(LIBRARY, "mallinfo2"), reason="another C library")
def test_large_blocks_go_back_to_the_system(tmp_path: Path) -> None:
    """The allocator took them into heaps after the first had been freed: 130 MB more after a dozen services."""
    LIBRARY.mallinfo2.restype = _Figures
    Fuzzer(1, tmp_path).close()
    np.zeros(25 * LARGE_BYTES, dtype=np.uint8).fill(1)  # glibc would raise its limit to this size now
    before = LIBRARY.mallinfo2().hblkhd
    block = np.zeros(24 * LARGE_BYTES, dtype=np.uint8)
    assert LIBRARY.mallinfo2().hblkhd - before >= block.nbytes
    del block
    assert LIBRARY.mallinfo2().hblkhd <= before


@pytest.mark.skipif(not hasattr(LIBRARY, "mallinfo2"), reason="another C library")
def test_memory_that_is_wanted_again_and_again_is_not_fetched_from_the_system_each_time() -> None:
    """In a process of its own: what others have left in the heap would be enough."""
    taken = """
import resource
import numpy as np
from autopilot.run.session import LARGE_BYTES, give_back_large_blocks

def pages() -> int:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    blocks = [np.ones(LARGE_BYTES // 2, dtype=np.uint8) for _ in range(16)]
    del blocks
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

give_back_large_blocks()
pages()
print(min(pages() for _ in range(3)))
"""
    run = subprocess.run([sys.executable, "-c", taken], capture_output=True, text=True, check=True)
    assert int(run.stdout) < 200  # of 2048
