"""What the estimator of a logged run was given, tick by tick, exactly."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import MAX_THRUSTERS, Authority, Below, Drive
from autopilot.core.samples import (
    AhrsSample,
    DepthSample,
    ExternalFrame,
    ExternalPoseSample,
    ImuSample,
    LaserSample,
    MarkerSighting,
    PoseSample,
    Sample,
    VelocityLock,
    VelocitySample,
)
from autopilot.log.reader import Log

TICK = "/in/tick"
THRUST = "/nav/thrust"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EstimatorTick:
    """The arguments of one :meth:`autopilot.estimator.protocol.Estimator.step`."""

    t_us: int
    samples: tuple[Sample, ...]
    thrust_n: FloatArray
    """(MAX_THRUSTERS,), zero beyond those of the vehicle."""


def ahrs_sample(row: Any) -> AhrsSample:
    """From a row of ``/in/ahrs_raw``."""
    return AhrsSample(
        t_us=int(row["t_us"]),
        rpy_rad=row["rpy_rad"].copy(),
        rate_frd_rad_s=row["rate_frd_rad_s"].copy(),
        accel_frd_m_s2=row["accel_frd_m_s2"].copy(),
    )


def imu_sample(row: Any) -> ImuSample:
    """From a row of ``/in/imu``."""
    return ImuSample(
        t_us=int(row["t_us"]),
        rate_frd_rad_s=row["rate_frd_rad_s"].copy(),
        accel_frd_m_s2=row["accel_frd_m_s2"].copy(),
        mag_frd=row["mag_frd"].copy() if row["mag_known"] else None,
    )


def marker_sighting(row: Any) -> MarkerSighting:
    """From a row of ``/in/markers``."""
    count = int(row["count"])
    corners = row["corners_px"][: 8 * count].astype(float).reshape(count, 4, 2)
    # Logs from before this was known do not have it.
    sigma = row["sigma_px"][:count].astype(float) if "sigma_px" in row.dtype.names else np.zeros(count)
    return MarkerSighting(
        t_us=int(row["t_us"]),
        ids=tuple(int(i) for i in row["ids"][:count]),
        corners_px=corners,
        laser_px=row["laser_px"].copy() if row["laser_found"] else None,
        sigma_px=sigma if sigma.all() else None,
        decode_us=int(row["decode_us"]),
    )


def pose_sample(row: Any) -> PoseSample:
    """From a row of ``/in/pose``."""
    return PoseSample(
        t_us=int(row["t_us"]),
        pos_ned_m=row["pos_ned_m"].copy(),
        yaw_rad=float(row["yaw_rad"]),
        sigma_pos_m=row["sigma_pos_m"].copy(),
        sigma_yaw_rad=float(row["sigma_yaw_rad"]),
    )


def laser_sample(row: Any) -> LaserSample:
    """From a row of ``/in/laser_raw``."""
    return LaserSample(t_us=int(row["t_us"]), range_m=float(row["range_m"]), sigma_m=float(row["sigma_m"]))


def depth_sample(row: Any) -> DepthSample:
    """From a row of ``/in/depth``."""
    return DepthSample(t_us=int(row["t_us"]), depth_m=float(row["depth_m"]), sigma_m=float(row["sigma_m"]))


def velocity_sample(row: Any) -> VelocitySample:
    """From a row of ``/in/velocity``."""
    return VelocitySample(
        t_us=int(row["t_us"]),
        vel_frd_m_s=row["vel_frd_m_s"].copy(),
        sigma_m_s=row["sigma_m_s"].copy(),
        lock=VelocityLock(int(row["lock"])),
    )


def external_sample(row: Any) -> ExternalPoseSample:
    """From a row of ``/in/external`` or ``/nav/external``."""
    return ExternalPoseSample(
        t_us=int(row["t_us"]),
        pos_m=row["pos_m"].copy(),
        yaw_rad=float(row["yaw_rad"]),
        covariance=row["covariance"].reshape(4, 4).copy() if row["covariance_known"] else None,
        frame=ExternalFrame(int(row["frame"])),
        reset_counter=int(row["reset_counter"]),
    )


def below(row: Any) -> Below:
    """From a row of ``/in/below``. It is written when it changes: ``t_us`` is when it did."""
    return Below(
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


def drive(row: Any) -> Drive | None:
    """From a row of ``/ctl/drive``, None = the goal is a place."""
    if not row["active"]:
        return None
    down_m_s, yaw_rate_rad_s = float(row["down_m_s"]), float(row["yaw_rate_rad_s"])
    return Drive(
        north_m_s=float(row["north_m_s"]),
        east_m_s=float(row["east_m_s"]),
        turn_rad_s=float(row["turn_rad_s"]),
        down_m_s=None if math.isnan(down_m_s) else down_m_s,
        yaw_rate_rad_s=None if math.isnan(yaw_rate_rad_s) else yaw_rate_rad_s,
        yaw_trend_rad_s=float(row["yaw_trend_rad_s"]),
    )


READERS: dict[str, Callable[[Any], Sample]] = {
    "/in/ahrs_raw": ahrs_sample,
    "/in/imu": imu_sample,
    "/in/markers": marker_sighting,
    "/in/pose": pose_sample,
    "/in/laser_raw": laser_sample,
    "/in/depth": depth_sample,
    "/in/velocity": velocity_sample,
    "/in/external": external_sample,
    "/nav/external": external_sample,
}
"""Topic -> how a row of it becomes a sample."""

OTHERS = ("/in/tracks", "/in/power_raw", "/in/leak", "/in/hull", "/in/pilot")
"""Samples that estimators have no use for: only counted."""


def estimator_ticks(log: Log) -> Iterator[EstimatorTick]:
    """Every tick of the log in turn. LogError if inputs are missing: what follows could not be the same."""
    for topic in (TICK, THRUST):
        if topic not in log:
            raise LogError(f"{log.path}: has no {topic}, which replay needs; record the run with this version")
    topics = [TICK, THRUST, *(topic for topic in (*READERS, *OTHERS) if topic in log)]
    log.load(topics)
    tables = [log[topic] for topic in topics]
    told = [0] * len(topics)
    samples: list[Sample] = []
    thrust_n, t_us, promised, came = np.zeros(MAX_THRUSTERS), -1, 0, 0
    for number in log.order(topics):
        row = tables[number][told[number]]
        told[number] += 1
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
        raise LogError(
            f"{log.path}: {missing} of the inputs at {1e-6 * t_us:.2f} s are missing; 'log info' names the loss"
        )
    return EstimatorTick(t_us=t_us, samples=tuple(samples), thrust_n=thrust_n)
