"""Replays a logged run through the estimator: bit-identical, or with another estimator or other options.

The estimator gets the logged inputs (:mod:`autopilot.replay.inputs`): the same samples at the same ticks in the
same order, the same thrust, and vehicle file, marker map and options from the log's attachments. Unchanged, the
result has to be identical in every bit of every field.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from autopilot.core.disk import write_whole
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import NavState
from autopilot.estimator.create import create_estimator
from autopilot.estimator.options import EstimatorOptions
from autopilot.log.packing.records import pack_record
from autopilot.log.reader import Log, MessageTable
from autopilot.log.writer import LogWriter
from autopilot.record.estimator_setup import EstimatorSetup, read_markers, read_setup, read_vehicle
from autopilot.replay.inputs import estimator_ticks

_Bits: TypeAlias = dict[str, NDArray[Any]]

VECTORS = ("pos_ned_m", "rpy_rad", "vel_frd_m_s", "vel_water_frd_m_s", "rate_frd_rad_s", "current_ned_m_s")
"""Fields of /nav/state, in its order."""

MATCH_US = 5_000
"""Truth and estimate are of the same tick when their stamps are at most so far apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicMatch:
    """Comparison of one topic of the log with the replay."""

    topic: str
    logged: int
    identical: int
    first: str
    """Where and what the first difference is, empty without one."""

    @property
    def same(self) -> bool:
        """Every message is there and the same."""
        return self.logged == self.identical and not self.first


@dataclass(frozen=True, slots=True, kw_only=True)
class RmsError:
    """Root mean squares of one quantity over the run."""

    quantity: str
    unit: str
    difference: float
    """Replayed minus logged."""
    logged_error: float | None
    """Logged minus truth, None where the log has no truth."""
    replayed_error: float | None


def replay_setup(log: Log, estimator: str | None, changes: Sequence[str]) -> EstimatorSetup:
    """Setup of the logged estimator with changes.

    Parameters
    ----------
    log
        Log with the estimator's setup.
    estimator
        Name of another estimator, None = the logged one.
    changes
        ``NAME=VALUE`` of :class:`EstimatorOptions`.

    Returns
    -------
    EstimatorSetup

    Raises
    ------
    ConfigError
        A change names no option, or its value is not of the option's type.
    """
    setup = read_setup(log)
    values = asdict(setup.options)
    for change in changes:
        name, sign, text = change.partition("=")
        if not sign or name not in values:
            known = ", ".join(field.name for field in fields(EstimatorOptions))
            raise ConfigError(f"--set {change!r} is not an option and a value; use NAME=VALUE with one of {known}")
        try:
            values[name] = msgspec.convert(text, type(values[name]), strict=False)
        except msgspec.ValidationError as error:
            raise ConfigError(f"--set {change!r}: {error}; give a value of that kind") from error
    return msgspec.structs.replace(
        setup, name=setup.name if estimator is None else estimator, options=EstimatorOptions(**values)
    )


def replay(log: Log, setup: EstimatorSetup) -> list[NavState]:
    """Run an estimator on the logged inputs.

    Parameters
    ----------
    log
        Log with the inputs of every tick, from the start of the estimator.
    setup
        The estimator and its options (:func:`replay_setup`).

    Returns
    -------
    list of NavState
        One per tick (world NED, body FRD), from the initialisation on.

    Raises
    ------
    LogError
        Inputs are missing, or the log begins after the estimator (logs that begin at arming).
    """
    estimator = create_estimator(
        setup.name,
        read_vehicle(log),
        read_markers(log.attachments),
        floor_depth_m=setup.floor_depth_m,
        options=setup.options,
        shadow=setup.shadow,
    )
    states = []
    for tick in estimator_ticks(log):
        state = estimator.step(tick.t_us, tick.samples, tick.thrust_n)
        estimator.take_aids()
        if state is not None:
            states.append(state)
    return states


def refined_by(log: Log, setup: EstimatorSetup, markers: MarkerMap | None = None) -> MarkerMap:
    """Marker map as refined by the estimator at the end of a log. The log may begin anywhere.

    Parameters
    ----------
    log
        Log with the inputs of every tick.
    setup
        Options of the estimator (always the EKF).
    markers
        Prior map, None = the log's.

    Returns
    -------
    MarkerMap

    Raises
    ------
    LogError
        The run had no marker map, the map has no uncertainty to refine, or no marker was seen.
    """
    known = read_markers(log.attachments) if markers is None else markers
    if known is None:
        raise LogError(f"{log.path}: this run had no marker map; there is nothing to refine")
    if known.errors is None:
        raise LogError(
            f"{log.path}: the map is one sheet or said to be exact; give sheets or a sigma_m in the map file"
        )
    estimator = create_estimator(
        "ekf", read_vehicle(log), known, floor_depth_m=setup.floor_depth_m, options=setup.options
    )
    located = False
    for tick in estimator_ticks(log):
        located |= estimator.step(tick.t_us, tick.samples, tick.thrust_n) is not None
        estimator.take_aids()
    result = estimator.refined_map
    if not located or result is None:
        raise LogError(f"{log.path}: no position was found from the pictures of this log; the map stays as it is")
    return result


# Bit by bit.


def matches(log: Log, states: Sequence[NavState]) -> list[TopicMatch]:
    """Compare a replay with the log bit by bit.

    Parameters
    ----------
    log
        The log replayed.
    states
        Result of :func:`replay`.

    Returns
    -------
    list of TopicMatch
        For /nav/state, /nav/covariance and /nav/status.
    """
    by_time = {state.t_us: state for state in states}
    result = [_match(log, "/nav/state", by_time, lambda state: {name: getattr(state, name) for name in VECTORS})]
    if len(states) != result[0].logged:
        more = f"{len(states)} states against {result[0].logged} in the log"
        result[0] = replace(result[0], first=result[0].first or more)
    result.append(_match(log, "/nav/covariance", by_time, lambda state: {"variance": state.variance}))
    result.append(_match(log, "/nav/status", by_time, _status_bits))
    return result


def _status_bits(state: NavState) -> _Bits:
    return {"health": np.array(int(state.health), "u1"), "reset_count": np.array(state.reset_count, "<u4")}


def _match(log: Log, topic: str, by_time: dict[int, NavState], bits: Callable[[NavState], _Bits]) -> TopicMatch:
    table = log.get(topic)
    identical, first = 0, ""
    for row in () if table is None else table:
        state = by_time.get(int(row["t_us"]))
        place = "the replay has no state" if state is None else _differs(row, bits(state))
        if not place:
            identical += 1
        elif not first:
            first = f"at {1e-6 * int(row['t_us']):.2f} s: {place}"
    return TopicMatch(topic=topic, logged=0 if table is None else len(table), identical=identical, first=first)


def _differs(row: Any, now: _Bits) -> str:
    """The first field whose bits differ (NaN equals NaN, 0 differs from -0), empty if none does."""
    for name, value in now.items():
        if np.asarray(row[name]).tobytes() != value.tobytes():
            return f"{name} {row[name].tolist()} against {value.tolist()}"
    return ""


# The result with other settings.


def spreads(log: Log, states: Sequence[NavState]) -> list[RmsError]:
    """RMS of replay against log, and of both against the truth.

    Parameters
    ----------
    log
        The log replayed.
    states
        Result of :func:`replay`.

    Returns
    -------
    list of RmsError
        Over all common ticks; errors against the truth are None where the log has no truth.
    """
    logged = log["/nav/state"]
    now = _stacked(states)
    _, i, j = np.intersect1d(logged["t_us"], now["t_us"], return_indices=True)
    if not len(i):
        raise LogError(f"{log.path}: the replay gave no state at the times of /nav/state; nothing to compare")
    then = {name: logged[name][i] for name in VECTORS}
    new = {name: now[name][j] for name in VECTORS}
    truth = _truth(log, logged["t_us"][i])
    quantities = (
        ("position", "m", "pos_ned_m"),
        ("yaw", "rad", "rpy_rad"),
        ("velocity over ground", "m/s", "vel_frd_m_s"),
        ("velocity through water", "m/s", "vel_water_frd_m_s"),
        ("current", "m/s", "current_ned_m_s"),
    )
    return [
        RmsError(
            quantity=quantity,
            unit=unit,
            difference=_rms(name, new[name], then[name]),
            logged_error=None if truth is None else _rms(name, then[name], truth[name]),
            replayed_error=None if truth is None else _rms(name, new[name], truth[name]),
        )
        for quantity, unit, name in quantities
    ]


def _rms(name: str, a: FloatArray, b: FloatArray) -> float:
    """Root mean square of the length of the difference; of the angle of yaw alone for attitudes."""
    apart = np.array([wrap_pi(float(d)) for d in a[:, 2] - b[:, 2]])[:, None] if name == "rpy_rad" else a - b
    return float(np.sqrt((apart * apart).sum(axis=1).mean()))


def _truth(log: Log, t_us: FloatArray) -> MessageTable | None:
    """(n,) truth at the times ``t_us`` [us] (nearest message), None without it."""
    truth = log.get("/sim/truth")
    if truth is None:
        return None
    nearest = np.clip(np.searchsorted(truth["t_us"], t_us - MATCH_US), 0, len(truth) - 1)
    found: MessageTable = truth[nearest]
    return found


def _stacked(states: Sequence[NavState]) -> dict[str, FloatArray]:
    stacked = {name: np.array([getattr(state, name) for state in states]).reshape(-1, 3) for name in VECTORS}
    return {"t_us": np.array([state.t_us for state in states], dtype=np.int64), **stacked}


# Results to keep.


def write_replay(path: Path, log: Log, states: Sequence[NavState]) -> Path:
    """Write replayed states.

    Parameters
    ----------
    path
        ``.mcap`` (/nav/state, /nav/covariance, /nav/status) or ``.csv``.
    log
        The log replayed.
    states
        Result of :func:`replay`.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    LogError
        The suffix is another one.
    """
    if path.suffix == ".csv":
        return _write_csv(path, states)
    if path.suffix != ".mcap":
        raise LogError(f"replay: {path} is neither .csv nor .mcap; name a file with one of these endings")
    with LogWriter(
        path, epoch_ns=log.epoch_ns, metadata={**log.run, "replay_of": log.path.name}, attachments={}, lossless=True
    ) as writer:
        for state in states:
            stamp_ns = log.epoch_ns + state.t_us * 1000
            writer.write("/nav/state", state.t_us, pack_record("/nav/state", stamp_ns, state))
            writer.write("/nav/covariance", state.t_us, pack_record("/nav/covariance", stamp_ns, state))
            writer.write("/nav/status", state.t_us, pack_record("/nav/status", stamp_ns, state))
    return path


def _write_csv(path: Path, states: Sequence[NavState]) -> Path:
    columns = [f"{name}_{axis}" for name in VECTORS for axis in range(3)]
    columns += [f"variance_{n}" for n in range(12)]
    lines = [",".join(["t_us", *columns, "health", "reset_count"])]
    for state in states:
        values = [value for name in VECTORS for value in getattr(state, name).tolist()] + state.variance.tolist()
        lines.append(",".join([str(state.t_us), *map(repr, values), str(int(state.health)), str(state.reset_count)]))
    try:
        write_whole(path, "\n".join(lines) + "\n")
    except OSError as error:
        raise LogError(f"replay: {path} cannot be written ({error.strerror}); choose another place") from error
    return path
