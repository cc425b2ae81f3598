"""Fuzzers one after the other until as many messages have been thrown as are asked for."""

import os
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

import psutil

from autopilot.core.guard import VARIABLE
from tests.bench.fuzz.fuzzer import Fuzzer
from tests.bench.fuzz.result import Result

EPISODES = 12
"""Of one service: then comes one with another key, or none."""
GROWTH_MB = 80.0
"""Of the process's memory, beyond which the run has failed."""
SETTLED_MESSAGES = 20_000
"""Memory counts from here: everything has been imported and every cache is warm."""


def run_fuzz(messages: int, seed: int = 1, show: Callable[[Result], None] = lambda _: None) -> Result:
    """Throw ``messages`` at the service, and those of the last tick. A failure is kept, a fresh service goes on."""
    process = psutil.Process()
    guarded = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = "raise"
    try:
        return _run(messages, seed, show, process)
    finally:
        os.environ.pop(VARIABLE)
        if guarded is not None:
            os.environ[VARIABLE] = guarded


def _run(messages: int, seed: int, show: Callable[[Result], None], process: psutil.Process) -> Result:
    total = Result(seed=seed)
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        attempt = 0
        while total.messages < messages:
            fuzzer = Fuzzer(seed + 1000 * attempt, Path(folder) / str(attempt), signed=bool(attempt % 2))
            before = total.copy()
            attempt += 1
            try:
                for _ in range(EPISODES):
                    if total.messages >= messages:
                        break
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")  # overflow in what is made of nonsense is no finding
                        able = fuzzer.episode(most=messages - before.messages)
                    total.put_together(before, fuzzer.result)
                    total.seconds = time.monotonic() - began_s
                    total.rss_end_mb = process.memory_info().rss / 1e6
                    if not total.rss_start_mb and total.messages >= min(SETTLED_MESSAGES, messages // 2):
                        total.rss_start_mb = total.rss_end_mb
                    show(total)
                    if not able:
                        break
            except Exception as error:  # noqa: BLE001 - finding exceptions is what this is for
                total.put_together(before, fuzzer.result)
                place = _place(error)
                total.failures.append(f"seed {fuzzer.result.seed} tick {fuzzer.result.ticks}: {place}: {error}"[:600])
                show(total)
            finally:
                fuzzer.close()
    total.seconds = time.monotonic() - began_s
    if total.rss_start_mb and total.rss_end_mb > total.rss_start_mb + GROWTH_MB:
        total.failures.append(f"memory has grown from {total.rss_start_mb:.0f} to {total.rss_end_mb:.0f} MB")
    return total


def _place(error: BaseException) -> str:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno} in {frame.name}"
