"""Identification data from logs: windows of estimated motion and thrust."""

import math
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from autopilot.control.thrust.allocation import Allocation
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.frames import FloatArray
from autopilot.core.response import Response
from autopilot.core.vehicle import Vehicle
from autopilot.log.reader import Log, MessageTable, open_log
from autopilot.record.estimator_setup import VEHICLE_FILE, read_vehicle

STEP_S = 0.05
"""Interval of the prediction: thrust is averaged over it."""

WINDOW_STEPS = 80
"""Steps of a window (4 s): long enough for a force to show in the motion, short enough for small disturbances not
to."""

LAG_STEP_S = 0.01

MIN_WINDOWS = 10
"""Fewer give no estimate of their own scatter."""

IDLE_N = 0.3
"""Windows in which no thruster exceeds this do not excite the vehicle."""

GOOD = 2
"""Health in /nav/status (:class:`autopilot.core.messages.NavHealth`)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Windows:
    """Pieces of flight of the same length, one after another. m windows of n steps."""

    motion: FloatArray
    """(m, n + 1, 5) x, y, z [m, NED], yaw [rad, counts turns], yaw rate [rad/s]"""
    start: FloatArray
    """(m, 8) first guess of the state at the begin; the water is taken to stand still."""
    inputs: FloatArray
    """(m, n, thrusters + 4) averages over each step: what the thrusters gave (pulses, supply, lag) [N], roll and
    pitch [rad], roll and pitch rate [rad/s]"""
    flight: np.ndarray
    """(m,) int, which log each window is from"""


def read_windows(paths: list[Path], vehicle: Vehicle | None = None) -> tuple[Windows, Vehicle]:
    """Windows of all logs, and their vehicle file unless ``vehicle`` is given. LogError if a log lacks data or all
    together are too short; ConfigError if one is of a vehicle with other thrusters.
    """
    parts: list[Windows] = []
    for index, path in enumerate(paths):
        log = open_log(path)
        known = vehicle or read_vehicle(log)
        _same_thrusters(log, known)
        vehicle = known
        parts.append(_of_log(log, known, index))
    if vehicle is None:
        raise LogError("no log is given; name at least one")
    joined = Windows(
        motion=np.concatenate([part.motion for part in parts]),
        start=np.concatenate([part.start for part in parts]),
        inputs=np.concatenate([part.inputs for part in parts]),
        flight=np.concatenate([part.flight for part in parts]),
    )
    if len(joined.motion) < MIN_WINDOWS:
        seconds = WINDOW_STEPS * STEP_S
        raise LogError(
            f"{', '.join(str(path) for path in paths)}: {len(joined.motion)} windows of {seconds:g} s under thrust with"
            f" a good estimate; at least {MIN_WINDOWS} are needed: fly longer"
        )
    return joined, vehicle


class _Thruster(msgspec.Struct):
    name: str


class _Flown(msgspec.Struct):
    """Of the vehicle file in a log."""

    name: str
    thruster: list[_Thruster]


def _same_thrusters(log: Log, vehicle: Vehicle) -> None:
    try:
        flown = msgspec.json.decode(log.attachments.get(VEHICLE_FILE, b""), type=_Flown)
    except msgspec.MsgspecError:
        return  # not told, or by another version
    names, known = ([thruster.name for thruster in each] for each in (flown.thruster, vehicle.thrusters))
    if names != known:
        raise ConfigError(
            f"{log.path}: was flown by {flown.name} with the thrusters {', '.join(names)}, and {vehicle.name} has"
            f" {', '.join(known)}; name a vehicle with those, and logs of one vehicle only"
        )


def _of_log(log: Log, vehicle: Vehicle, index: int) -> Windows:
    nav, sent = _table(log, "/nav/state"), _table(log, "/out/thrusters")
    begin_s, end_s = float(nav["t_us"][0]) * 1e-6, float(nav["t_us"][-1]) * 1e-6
    begin_s = max(begin_s, float(sent["t_us"][0]) * 1e-6)
    t_s = np.arange(begin_s, end_s, STEP_S)
    if len(t_s) < 2:
        raise LogError(f"{log.path}: holds {end_s - begin_s:.2f} s of estimate; record a flight")
    nav_s, unique = np.unique(nav["t_us"] * 1e-6, return_index=True)
    rpy, rates = nav["rpy_rad"][unique], nav["rate_frd_rad_s"][unique]
    columns = [*nav["pos_ned_m"][unique].T, np.unwrap(rpy[:, 2]), rates[:, 2], *nav["vel_frd_m_s"][unique].T]
    leaning = np.column_stack([rpy[:, :2], rates[:, :2]])
    at = np.stack([np.interp(t_s, nav_s, column) for column in columns], axis=1)
    thrust = _acting(log, sent, vehicle, t_s)
    middle_s = t_s + 0.5 * STEP_S
    inputs = np.column_stack([thrust, *(np.interp(middle_s, nav_s, column) for column in leaning.T)])
    good = _good(log, t_s) & (np.abs(np.interp(t_s, nav_s, nav_s) - t_s) < STEP_S)
    count = (len(t_s) - 1) // WINDOW_STEPS
    chosen = []
    for n in range(count):
        piece = slice(n * WINDOW_STEPS, (n + 1) * WINDOW_STEPS)
        if good[piece].all() and good[piece.stop] and float(np.abs(thrust[piece]).max()) > IDLE_N:
            chosen.append(n * WINDOW_STEPS)
    rows = np.array(chosen, dtype=int)[:, None] + np.arange(WINDOW_STEPS + 1)
    start = at[rows[:, 0]][:, [0, 1, 2, 3, 5, 6, 7, 4]]
    return Windows(
        motion=at[rows][:, :, :5],
        start=start,
        inputs=inputs[rows[:, :-1]],
        flight=np.full(len(rows), index),
    )


def _table(log: Log, topic: str) -> MessageTable:
    table = log.get(topic)
    if table is None or len(table) < 2:
        raise LogError(f"{log.path}: holds no {topic}; identification needs the log of a flight")
    return table


def _acting(log: Log, sent: MessageTable, vehicle: Vehicle, t_s: FloatArray) -> FloatArray:
    """(len(t_s), thrusters) mean thrust over the step from each time on, of pulses and supply, behind the lag."""
    allocation, response = Allocation(vehicle.thrusters), Response.of(vehicle.thrusters)
    count, power = len(vehicle.thrusters), log.get("/in/power_raw")
    fine_s = np.arange(float(t_s[0]), float(t_s[-1]) + STEP_S, LAG_STEP_S)
    held = np.clip(np.searchsorted(sent["t_us"] * 1e-6, fine_s + 1e-9, side="right") - 1, 0, None)
    supply = np.full(len(sent), math.nan)
    if power is not None:
        supply = np.interp(sent["t_us"], power["t_us"], power["voltage_v"])
    settled = np.array(
        [
            allocation.thrusts_n([int(pulse) for pulse in row[:count]], None if math.isnan(volts) else float(volts))
            for row, volts in zip(sent["pwm_us"], supply, strict=True)
        ]
    )[held]
    acting, gain, level = np.empty_like(settled), response.fraction(LAG_STEP_S), np.zeros(count)
    for n, target in enumerate(settled):
        before = level
        level = level + gain * (target - level)
        acting[n] = 0.5 * (before + level)
    per_step = round(STEP_S / LAG_STEP_S)
    whole = acting[: len(t_s) * per_step]
    padded = np.vstack([whole, np.repeat(whole[-1:], len(t_s) * per_step - len(whole), axis=0)])
    result: FloatArray = padded.reshape(len(t_s), per_step, count).mean(axis=1)
    return result


def _good(log: Log, t_s: FloatArray) -> np.ndarray:
    """(len(t_s),) whether the estimate was good and the vehicle armed."""
    result = np.ones(len(t_s), dtype=bool)
    for topic, field, wanted in (("/nav/status", "health", GOOD), ("/sys/mode", "armed", 1)):
        table = _table(log, topic)
        row = np.searchsorted(table["t_us"] * 1e-6, t_s, side="right") - 1
        result &= (row >= 0) & (table[field][np.clip(row, 0, None)] == wanted)
    return result
