"""Errors of current forecasts along the path of a logged flight, against the simulator's truth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from autopilot.analysis.nmpc_flight import TANK
from autopilot.control.current.current_learning import EstimatedFlow
from autopilot.control.current.currents import (
    CurrentForecast,
    EstimatedCurrent,
    NoCurrent,
)
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.log.analysis import STATE_FIELDS
from autopilot.log.reader import Log, open_log

STEP_S = 0.05
"""Update interval of the controller."""
JUDGE_EVERY = 16
"""Number of updates from one evaluated forecast to the next."""
AHEAD_S = 8.0
"""The controller's horizon."""
SAMPLE_S = 0.1
NEW_GOAL_M = 0.1

TOPICS = ("/nav/state", "/nav/covariance", "/sim/truth", "/ctl/goal", "/mission/progress")


@dataclass(frozen=True, slots=True, kw_only=True)
class ForecastRow:
    """Mean error [m/s] of one forecast in one lap (from 1)."""

    forecast: str
    lap: int
    next_8_s: float
    rest_of_leg: float
    revisions: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Flight:
    """Data from a log. Times in seconds."""

    nav: NDArray[np.void]
    variance: FloatArray
    t_s: FloatArray
    pos_ned_m: FloatArray
    current_ned_m_s: FloatArray
    goal_s: FloatArray
    """When a leg begins; the last one is when the mission ended."""
    lap: NDArray[np.int64]
    """Of each leg, from 1."""


def compare_forecasts(path: Path) -> list[ForecastRow]:
    """Evaluate the forecasts along a simulated flight's log. LogError if the log lacks data."""
    flight = _flight(open_log(path))
    flow = EstimatedFlow()
    flow.within(TANK)
    forecasts: dict[str, CurrentForecast] = {
        "none": NoCurrent(),
        "uniform": EstimatedCurrent(),
        "estimate": flow,
    }
    return [row for name, forecast in forecasts.items() for row in _judge(name, forecast, flight)]


def _flight(log: Log) -> _Flight:
    missing = [topic for topic in TOPICS if topic not in log.topics]
    if missing:
        raise log.lacks(f"no {', '.join(missing)}", "give the log of a simulated mission")
    nav, truth, goal, progress = log["/nav/state"], log["/sim/truth"], log["/ctl/goal"], log["/mission/progress"]
    moved = np.abs(np.diff(goal["pos_ned_m"], axis=0)).max(axis=1) > NEW_GOAL_M
    begins = goal["t_us"][1:][moved & (goal["seq"][1:] >= 0)]
    if len(begins) < 2:
        raise LogError(f"{log.path}: has no leg of a mission; give the log of a simulated mission")
    lap = progress["lap"][np.clip(np.searchsorted(progress["t_us"], begins, side="right") - 1, 0, None)]
    # After the mission the vehicle holds its last goal: that is no leg.
    flying = progress["t_us"][progress["state"] == progress["state"][progress["t_us"] >= begins[0]][0]]
    flown = max(int(flying[-1]), int(begins[-1]))
    rows = np.clip(np.searchsorted(log["/nav/covariance"]["t_us"], nav["t_us"]), 0, len(log["/nav/covariance"]) - 1)
    return _Flight(
        nav=nav,
        variance=log["/nav/covariance"]["variance"][rows],
        t_s=truth["t_us"] * 1e-6,
        pos_ned_m=truth["pos_ned_m"],
        current_ned_m_s=truth["current_ned_m_s"],
        goal_s=np.append(begins, flown) * 1e-6,
        lap=lap.astype(np.int64) + 1,
    )


def _judge(name: str, forecast: CurrentForecast, flight: _Flight) -> list[ForecastRow]:
    errors: dict[int, list[tuple[float, float]]] = {}
    revisions: dict[int, list[int]] = {}
    nav_s = flight.nav["t_us"] * 1e-6
    for index, now_s in enumerate(np.arange(nav_s[0], flight.goal_s[-1] - STEP_S, STEP_S)):
        nav = _nav(flight, min(int(np.searchsorted(nav_s, now_s)), len(nav_s) - 1))
        forecast.view(nav)
        leg = int(np.searchsorted(flight.goal_s, now_s, side="right")) - 1
        if not 0 <= leg < len(flight.lap):
            continue
        lap = int(flight.lap[leg])
        revisions.setdefault(lap, []).append(forecast.revision(nav))
        if index % JUDGE_EVERY:
            continue
        ends_s = (min(now_s + AHEAD_S, flight.goal_s[-1]), flight.goal_s[leg + 1])
        pair = [_error_m_s(forecast, nav, flight, now_s, end_s) for end_s in ends_s]
        errors.setdefault(lap, []).append((pair[0], pair[1]))
    return [
        ForecastRow(
            forecast=name,
            lap=lap,
            next_8_s=float(np.mean([e[0] for e in found])),
            rest_of_leg=float(np.mean([e[1] for e in found])),
            revisions=revisions[lap][-1] - revisions[lap][0],
        )
        for lap, found in sorted(errors.items())
    ]


def _error_m_s(forecast: CurrentForecast, nav: NavState, flight: _Flight, now_s: float, end_s: float) -> float:
    """Mean horizontal error along the path from now to then."""
    at = np.minimum(np.searchsorted(flight.t_s, np.arange(now_s, end_s, SAMPLE_S)), len(flight.t_s) - 1)
    out = np.empty((len(at), 3))
    forecast.fill(nav, flight.pos_ned_m[at], flight.t_s[at] - nav.t_us * 1e-6, out)
    wrong = out - flight.current_ned_m_s[at]
    return float(np.hypot(wrong[:, 0], wrong[:, 1]).mean())


def _nav(flight: _Flight, row: int) -> NavState:
    nav = flight.nav[row]
    return NavState(
        t_us=int(nav["t_us"]),
        health=NavHealth.GOOD,
        variance=flight.variance[row],
        **{name: nav[name] for name in STATE_FIELDS},
    )
