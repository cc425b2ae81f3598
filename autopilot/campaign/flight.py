"""Flies one run: the whole service on the drawn scenario, without sockets, judged on the ground truth."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from autopilot.campaign.judge import judge
from autopilot.campaign.results import RunResult, Task
from autopilot.campaign.tick_watch import TickWatch
from autopilot.core.errors import ConfigError
from autopilot.run.config import EffectiveSettings, flight_settings
from autopilot.run.sitl_describe import describe_run
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.plant import Truth

Watch = TypeVar("Watch", bound=TickWatch)


def run_watched(
    settings: EffectiveSettings,
    params: dict[str, float],
    kind: Callable[[Callable[[], Truth]], Watch],
    stop: Callable[[], bool],
    over: Callable[[Watch], bool],
) -> tuple[SitlSession, Watch] | None:
    """Fly in lockstep with a watch of that kind until it is ``over`` or the duration ends; None if ``stop`` ended
    the run. AutopilotError if it cannot be flown.
    """
    watch = kind(lambda: session.device.truth)
    session = open_sitl(settings, params, log=settings["log"] is not None, on_tick=watch.tick)
    stopped = False

    def enough() -> bool:
        nonlocal stopped
        stopped = stop()
        return stopped or over(watch)

    session.run(enough)
    return None if stopped else (session, watch)


def fly(task: Task, stop: Callable[[], bool] = lambda: False, *, log: Path | None = None) -> RunResult | None:
    """Fly one run of a campaign.

    Parameters
    ----------
    task
        The drawn scenario.
    stop
        Polled during the run; True ends it.
    log
        File to record the run in, None = no log.

    Returns
    -------
    RunResult or None
        None if ``stop`` ended the run.

    Raises
    ------
    AutopilotError
        The run cannot be flown.
    """
    cpu_s = time.process_time()
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder, _without(folder):
        settings = settings_of(task, Path(folder), log)
        flown = run_watched(settings, task.params, TickWatch, stop, lambda watch: watch.over)
        if flown is None:
            return None
        session, watch = flown
        run = describe_run(session.world.scenario, session.parts, seed=task.seed, speed=0.0)
        return judge(task, session.world.scenario, run, watch, session.device.truth, time.process_time() - cpu_s)


def check(task: Task) -> None:
    """Open a run without flying it. AutopilotError if that is not possible."""
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder, _without(folder):
        open_sitl(settings_of(task, Path(folder)), task.params, log=False).close()


@contextmanager
def _without(folder: str) -> Iterator[None]:
    """Errors without the folder, which is another one in every run and soon gone."""
    try:
        yield
    except ConfigError as error:
        raise type(error)(str(error).replace(f"{folder}/", "")) from error


def settings_of(task: Task, folder: Path, log: Path | None = None) -> EffectiveSettings:
    """The settings of a run, whose files are written into the folder."""
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
