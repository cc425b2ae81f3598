"""Logged inputs of the estimator, tick by tick, bit-identical."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from autopilot.core.clock import TICK_US
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import MAX_THRUSTERS, Authority, FlightControllerState, VelocityGoal
from autopilot.core.samples import MarkerSighting, Sample
from autopilot.log.packing.records import reader_of
from autopilot.log.reader import Log
from autopilot.log.sample_table import SAMPLE_ROWS

TICK = "/in/tick"
THRUST = "/nav/thrust"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EstimatorTick:
    """The arguments of one :meth:`autopilot.estimator.protocol.Estimator.step`."""

    t_us: int
    samples: tuple[Sample, ...]
    thrust_n: FloatArray
    """(MAX_THRUSTERS,), zero beyond those of the vehicle."""


def marker_sighting(row: Any) -> MarkerSighting:
    """From a row of ``/in/markers``."""
    count = int(row["count"])
    corners = row["corners_px"][: 8 * count].astype(float).reshape(count, 4, 2)
    # Logs from before sigmas were known do not have them.
    sigma = row["sigma_px"][:count].astype(float) if "sigma_px" in row.dtype.names else np.zeros(count)
    return MarkerSighting(
        t_us=int(row["t_us"]),
        ids=tuple(int(i) for i in row["ids"][:count]),
        corners_px=corners,
        laser_px=row["laser_px"].copy() if row["laser_found"] else None,
        sigma_px=sigma if sigma.all() else None,
        decode_us=int(row["decode_us"]),
        stamp_sigma_s=float(row["stamp_sigma_s"]) if "stamp_sigma_s" in row.dtype.names else 0.0,
    )


def below(row: Any) -> FlightControllerState:
    """Flight controller state from a row of ``/in/below``, which is written on change: ``t_us`` is the time of the
    change.
    """
    return FlightControllerState(
        t_us=int(row["t_us"]),
        authority=tuple(Authority)[int(row["authority"])],
        acts=bool(row["acts"]),
        text=_text(row["text"]),
        problem=_text(row["problem"]),
        refusals=tuple(_text(row["refusals"]).splitlines()),
        pulses_us=tuple(int(pulse) for pulse in row["pulses_us"][: int(row["thrusters"])]),
        armed=(False, True, None)[int(row["armed"])],
        rival=bool(row["rival"]),
    )


def _text(field: Any) -> str:
    return bytes(field).rstrip(b"\0").decode(errors="replace")


def drive(row: Any) -> VelocityGoal | None:
    """Velocity goal from a row of ``/ctl/drive``, None = the goal is a position."""
    goal: VelocityGoal | None = _velocity_goal(row) if row["active"] else None
    return goal


_velocity_goal = reader_of(VelocityGoal)
SAMPLES: dict[str, Callable[[Any], Sample]] = {
    row.topic: reader_of(row.of, known=row.known, shapes=row.shapes)
    for row in SAMPLE_ROWS
    if row.of is not MarkerSighting
} | {"/in/markers": marker_sighting}
"""Topic -> how a row of it becomes a sample; every kind of sample is in exactly one of them."""
OTHERS = tuple(row.topic for row in SAMPLE_ROWS if not row.estimator)
"""Samples that estimators have no use for: only counted."""
READERS = {topic: read for topic, read in SAMPLES.items() if topic not in OTHERS} | {
    "/nav/external": SAMPLES["/in/external"]
}
"""Sample types that estimators use."""


def require_start(log: Log) -> None:
    """LogError if the run had begun before its log: ticks are missing that were not skipped as too late."""
    first = log[TICK][0] if len(log[TICK]) else None
    if first is not None and int(first["t_us"]) > (1 + int(first["overruns"])) * TICK_US:
        raise LogError(
            f"{log.path}: begins at {1e-6 * int(first['t_us']):.2f} s, when the service was already running; "
            "replay needs a log from the start (--log FILE)"
        )


def estimator_ticks(log: Log) -> Iterator[EstimatorTick]:
    """Logged inputs of the estimator.

    Parameters
    ----------
    log
        Log with the inputs of every tick.

    Yields
    ------
    EstimatorTick
        Every tick in turn.

    Raises
    ------
    LogError
        Inputs are missing, so that a replay could not be identical.
    """
    for topic in (TICK, THRUST):
        if topic not in log:
            raise log.lacks(f"no {topic}, which replay needs", "record the run with this version")
    topics = [TICK, THRUST, *(topic for topic in (*READERS, *OTHERS) if topic in log)]
    log.load(topics)
    require_start(log)
    tables = [log[topic] for topic in topics]
    positions = [0] * len(topics)
    samples: list[Sample] = []
    thrust_n, t_us, promised, came = np.zeros(MAX_THRUSTERS), -1, 0, 0
    for number in log.order(topics):
        row = tables[number][positions[number]]
        positions[number] += 1
        topic = topics[number]
        if topic == TICK:
            if t_us >= 0:
                yield _tick(log, t_us, samples, thrust_n, promised - came)
            t_us, promised, came, samples = int(row["t_us"]), int(row["samples"]), 0, []
        elif topic == THRUST:
            thrust_n = row["thrust_n"].copy()
        else:
            came += topic.startswith("/in/")
            if topic in READERS:
                samples.append(READERS[topic](row))
    if t_us >= 0 and promised == came:
        yield _tick(log, t_us, samples, thrust_n, 0)


def _tick(log: Log, t_us: int, samples: list[Sample], thrust_n: FloatArray, missing: int) -> EstimatorTick:
    if missing:
        at = f"{1e-6 * t_us:.2f} s"
        lost = f"{missing} of the inputs at {at} are" if missing > 0 else f"the tick of {-missing} inputs after {at} is"
        raise LogError(f"{log.path}: {lost} missing; 'log info' names the loss")
    return EstimatorTick(t_us=t_us, samples=tuple(samples), thrust_n=thrust_n)
