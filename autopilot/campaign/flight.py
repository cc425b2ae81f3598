"""Flies one run: the whole service on the drawn scenario, without sockets, judged on the ground truth."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from autopilot.campaign.results import Margin, RunResult, Task
from autopilot.campaign.tick_watch import TickWatch
from autopilot.campaign.tube_study import AHEAD_S
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.log.analysis import (
    Span,
    VehicleTrack,
    clearances,
    lap_spans,
    visits,
)
from autopilot.log.description import RunDescription
from autopilot.log.smoothness import measure
from autopilot.run.config import EffectiveSettings, flight_settings
from autopilot.run.sitl_describe import describe_run
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Scenario

Watch = TypeVar("Watch", bound=TickWatch)
SIGMAS = 3.0
THRUST_TOLERANCE_N = 1e-6
"""Rounding: a command at its limit is not beyond it."""


def judge(task: Task, scenario: Scenario, run: RunDescription, watch: TickWatch, end: Truth, cpu_s: float) -> RunResult:
    """A run judged as ``autopilot log check`` does; ``end`` is the truth at its end. A run never armed has failed."""
    if not len(watch.rows):
        return task.failed(f"was never armed: {watch.not_armed or 'nobody asked for it'}")
    flown = RunResult(
        run=task.run,
        seed=task.seed,
        drawn=task.drawn,
        simulated_s=end.t_us * 1e-6,
        cpu_s=round(cpu_s, 2),
        judged=scenario.accept.campaign,
        laps_asked=run.accept.laps,
        completed=watch.completed,
        margins=_margins(run, watch),
        contacts=end.contact_count,
        penetration_m=end.max_penetration_m,
        steps=watch.steps,
        fallbacks=watch.fallbacks,
        slack_max=watch.slack_max,
        failsafes=watch.failsafe_names,
        events=watch.events,
        tube_shares=[fraction for fraction in map(watch.tube.fraction, AHEAD_S) if fraction is not None],
        smoothness=measure(watch.commands(run.parameters["THR_LIMIT"])),
    )
    spans = lap_spans(visits(watch.track, run), run, watch.mission.start_s)
    return msgspec.structs.replace(
        flown,
        laps=len(spans),
        energy_j=[_energy_j(watch, span) for span in spans],
        lap_s=[span.end_s - span.start_s for span in spans],
        **_estimate(watch),
    )


def _margins(run: RunDescription, watch: TickWatch) -> dict[str, Margin]:
    """Every bound of the scenario and of the plan."""
    accept: dict[str, float] = {name: bound for name, bound in asdict(run.accept).items() if bound is not None}
    track = watch.track
    judged = track.between(watch.mission)
    found: dict[str, Margin] = {}

    def add(name: str, margins: FloatArray, at: VehicleTrack, tolerance: float) -> None:
        if len(margins):
            # A number that is none is the worst there is.
            worst = int(np.argmin(np.where(np.isnan(margins), -np.inf, margins)))
            found[name] = Margin(
                margin=round(float(margins[worst]), 5), at_s=round(float(at.t_s[worst]), 2), tolerance=tolerance
            )

    near = accept["tolerance_m"]
    for name, distance_m, limit in clearances(track, run):
        add(name, distance_m - limit, track, near)
    depth = judged.pos_ned_m[:, 2]
    add("shallowest", depth - accept["depth_min_m"], judged, near)
    add("deepest", accept["depth_max_m"] - depth, judged, near)
    bounds = run.paper_bounds
    for name, values, limit, allowed in (
        ("planar speed", judged.planar_speed_m_s, bounds["planar_speed_m_s"], accept["planar_speed_m_s"]),
        ("heave", np.abs(judged.vel_level_m_s[:, 2]), bounds["heave_m_s"], accept["heave_m_s"]),
        ("yaw rate", np.abs(judged.rate_frd_rad_s[:, 2]), bounds["yaw_rate_rad_s"], accept["yaw_rate_rad_s"]),
    ):
        add(name, limit - values, judged, round(max(0.0, allowed - limit), 6))
    command_n = watch.column("thrust_n")[watch.mission.holds(track.t_s)]
    add("thrust", min(bounds["thrust_n"], accept["thrust_n"]) - command_n, judged, THRUST_TOLERANCE_N)
    return found


def _energy_j(watch: TickWatch, span: Span) -> float:
    """Energy of thrusters and hotel load in a span: trapezoidal rule at 100 Hz."""
    keep = span.holds(watch.column("t_s"))
    t_s, power_w = watch.column("t_s")[keep], watch.column("power_w")[keep]
    return round(float(np.sum(0.5 * (power_w[1:] + power_w[:-1]) * np.diff(t_s))), 2)


def _estimate(watch: TickWatch) -> dict[str, float]:
    """Errors of the estimate until the mission is complete."""
    rows = watch.rows[watch.mission.holds(watch.column("t_s"))]
    rows = rows[~np.isnan(rows[:, 21])]
    if not len(rows):
        return {}
    errors, sigma = rows[:, 21:27], rows[:, 27:31]
    in_sigmas = errors[:, :4] / sigma
    distance2 = np.sum(errors[:, :3] ** 2, axis=1)
    return {
        "pos_rms_m": round(float(np.sqrt(np.mean(distance2))), 6),
        "pos_max_m": round(float(np.sqrt(np.max(distance2))), 6),
        "yaw_rms_rad": round(float(np.sqrt(np.mean(errors[:, 3] ** 2))), 6),
        "current_rms_m_s": round(float(np.sqrt(np.mean(np.sum(errors[:, 4:6] ** 2, axis=1)))), 6),
        "inside_share": round(float(np.mean((np.abs(in_sigmas) <= SIGMAS).all(axis=1))), 5),
        "nees": round(float(np.mean(in_sigmas**2)), 4),
    }


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
