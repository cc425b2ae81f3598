"""Fly one run: the whole service on the drawn scenario, without sockets and mostly without log, judged on the truth."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from autopilot.campaign.judge import judge
from autopilot.campaign.results import RunResult, Task
from autopilot.campaign.tick_watch import TickWatch
from autopilot.run.config import EffectiveSettings, flight_settings
from autopilot.run.sitl_describe import describe_run
from autopilot.run.sitl_session import open_sitl


def fly(task: Task, stop: Callable[[], bool] = lambda: False, *, log: Path | None = None) -> RunResult | None:
    """The result, None if ``stop`` said so before the end; ``log``: file that the run is recorded in.

    AutopilotError if it cannot be flown."""
    cpu_s = time.process_time()
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        watch = TickWatch(lambda: session.device.truth)
        session = open_sitl(_settings(task, Path(folder), log), task.params, log=log is not None, on_tick=watch.tick)
        stopped = False

        def enough() -> bool:
            nonlocal stopped
            stopped = stop()
            return stopped or watch.over

        session.run(enough)
        if stopped:
            return None
        run = describe_run(session.scenario, session.parts, seed=task.seed, speed=0.0)
        return judge(task, session.scenario, run, watch, session.device.truth, time.process_time() - cpu_s)


def _settings(task: Task, folder: Path, log: Path | None) -> EffectiveSettings:
    scenario = folder / "scenario.toml"
    scenario.write_text(task.scenario_toml, encoding="utf-8")
    (folder / task.plan_name).write_bytes(task.plan)
    given = {
        "scenario": str(scenario),
        "seed": task.seed,
        "start": True,
        "estimator": task.estimator,
        "sensors": task.sensors,
        "duration": task.duration_s,
        "log": None if log is None else str(log),
    }
    return flight_settings(folder, given)
