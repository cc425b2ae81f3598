"""Fly one run: the whole service on the drawn scenario, without sockets and mostly without log, judged on the truth."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from autopilot.campaign.judge import judge
from autopilot.campaign.results import RunResult, Task
from autopilot.campaign.watch import Watch
from autopilot.core.messages import Outputs
from autopilot.run.config import Settings, gather, sitl_defaults
from autopilot.run.sitl_describe import describe_run
from autopilot.run.sitl_session import open_sitl


def fly(task: Task, stop: Callable[[], bool] = lambda: False, *, log: Path | None = None) -> RunResult | None:
    """The result, None if ``stop`` said so before the end; ``log``: file that the run is recorded in.

    AutopilotError if it cannot be flown."""
    cpu_s = time.process_time()
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        watches: list[Watch] = []

        def each_tick(outputs: Outputs) -> None:
            watches[0].tick(outputs)

        settings = _settings(task, Path(folder))
        if log is not None:
            settings.put("log", str(log), "campaign")
        session = open_sitl(settings, task.params, log=log is not None, on_tick=each_tick)
        watch = Watch(lambda: session.device.truth)
        watches.append(watch)
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


def _settings(task: Task, folder: Path) -> Settings:
    """Settings of the run: nothing from the environment, nothing left behind outside ``folder``."""
    scenario = folder / "scenario.toml"
    scenario.write_text(task.scenario_toml, encoding="utf-8")
    (folder / task.plan_name).write_bytes(task.plan)
    given = {
        "scenario": str(scenario),
        "speed": 0.0,
        "seed": task.seed,
        "start": True,
        "estimator": task.estimator,
        "sensors": task.sensors,
        "duration": task.duration_s,
    }
    settings = gather(sitl_defaults(0), given, {})
    settings.put("connect", (), "campaign")
    settings.put("state_dir", str(folder), "campaign")
    return settings
