"""External poses: VISION_POSITION_ESTIMATE and ODOMETRY become samples for the estimator.

Both carry a covariance of x, y, z, roll, pitch, yaw as the upper triangle by rows; NaN in its first place means that it
is not known (https://mavlink.io/en/messages/common.html). Bad numbers are passed on: the estimator counts them.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from pymavlink.dialects.v20 import development as mav

from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray, rpy_from_quat
from autopilot.core.samples import ExternalFrame, ExternalPoseSample
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.first_sender import FirstSender
from autopilot.mavlink.wire import Message

OLDEST_US = 1_000_000
"""A time stamp that lies this little in the past is taken as one of our clock."""
FAILED_QUALITY = -1
"""ODOMETRY.quality of an estimate that has failed."""
SAMPLES_MAX = 256
"""Poses accepted per tick; others are dropped."""

SILENT_US = 2_000_000
"""After so long without a pose of the sender in use another one may take its place."""

_FRAMES = {mav.MAV_FRAME_LOCAL_NED: ExternalFrame.NED, mav.MAV_FRAME_LOCAL_FRD: ExternalFrame.FRD}
_PLACES = (0, 1, 2, 5)
"""x, y, z, yaw among the six."""


class ExternalPoses:
    def __init__(self, ctx: Context, utc_offset_us: Callable[[], int | None]) -> None:
        """``utc_offset_us``: Unix time minus service time, None while unknown."""
        self._ctx = ctx
        self._utc_offset_us = utc_offset_us
        self._reported: set[MavlinkPeer] = set()
        self._by_arrival: dict[MavlinkPeer, ExternalPoseSample] = {}
        """Last pose of each sender whose time stamps are unusable."""
        self._sender = FirstSender(SILENT_US)
        """In use: two do not measure in one frame, and each counts its own resets."""

    def on_vision_position_estimate(self, peer: MavlinkPeer, msg: Message) -> None:
        """VISION_POSITION_ESTIMATE: local NED, radians."""
        reset_counter = getattr(msg, "reset_counter", 0)
        self._add(peer, msg.usec, (msg.x, msg.y, msg.z), msg.yaw, msg.covariance, ExternalFrame.NED, reset_counter)

    def on_odometry(self, peer: MavlinkPeer, msg: Message) -> None:
        """ODOMETRY: its pose; the velocity is not used."""
        frame = _FRAMES.get(msg.frame_id)
        if frame is None:
            self._report_once(notices.ODOMETRY_FRAME(frame=msg.frame_id), peer)
            return
        if getattr(msg, "quality", 0) == FAILED_QUALITY:
            return
        self._add(
            peer, msg.time_usec, (msg.x, msg.y, msg.z), _yaw(msg.q), msg.pose_covariance, frame, msg.reset_counter
        )

    def _report_once(self, notice: notices.OperatorText, peer: MavlinkPeer) -> None:
        if peer not in self._reported and len(self._reported) < SAMPLES_MAX:
            self._reported.add(peer)
            self._ctx.say(notice, peer)

    def _uses(self, peer: MavlinkPeer) -> bool:
        used, first = self._sender.takes(peer, self._ctx.t_us), self._sender.peer
        if not used and first is not None:
            name = "another one" if first.name == peer.name else first.name
            self._report_once(notices.SECOND_POSES(second=peer.name, first=name), peer)
        return used

    def _add(
        self,
        peer: MavlinkPeer,
        stamp_us: int,
        pos_m: Sequence[float],
        yaw_rad: float,
        triangle: Sequence[float],
        frame: ExternalFrame,
        reset_counter: int,
    ) -> None:
        waiting = self._ctx.samples
        if len(waiting) >= SAMPLES_MAX or not self._uses(peer):
            return
        stamped_us = self._stamped_us(stamp_us)
        arrived_us = self._ctx.t_us - round(1e6 * self._ctx.params["EST_EXT_DELAY"])
        sample = ExternalPoseSample(
            t_us=arrived_us if stamped_us is None else stamped_us,
            pos_m=np.array(pos_m, dtype=float),
            yaw_rad=float(yaw_rad),
            covariance=_covariance(triangle),
            frame=frame,
            reset_counter=reset_counter,
        )
        if stamped_us is None:
            # Of several that arrive at once, after a pause of the loop or of the network, only the last is current.
            before = self._by_arrival.get(peer)
            waiting[:] = [other for other in waiting if other is not before]
            if peer not in self._by_arrival and len(self._by_arrival) >= SAMPLES_MAX:
                self._by_arrival.clear()
            self._by_arrival[peer] = sample
        waiting.append(sample)

    def _stamped_us(self, stamp_us: int) -> int | None:
        """Validity time of the pose: its stamp if that is of our clock or of a known Unix time, else None."""
        now_us, offset_us = self._ctx.t_us, self._utc_offset_us()
        for time_us in (stamp_us, stamp_us - offset_us if offset_us is not None else -1):
            if 0 <= now_us - time_us <= OLDEST_US:
                return time_us
        return None


def _covariance(triangle: Sequence[float]) -> FloatArray | None:
    """(4, 4) of x, y, z, yaw; None if the source does not know it."""
    if math.isnan(triangle[0]):
        return None
    full = np.zeros((6, 6))
    full[np.triu_indices(6)] = triangle
    full = np.triu(full) + np.triu(full, 1).T
    return full[np.ix_(_PLACES, _PLACES)]


def _yaw(quat: Sequence[float]) -> float:
    """Yaw of a quaternion [w, x, y, z] of any length; NaN if it is invalid."""
    length = math.sqrt(sum(a * a for a in quat))
    if not (math.isfinite(length) and length > 1e-3):
        return math.nan
    return float(rpy_from_quat([a / length for a in quat])[2])
