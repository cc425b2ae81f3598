"""Offboard setpoints: SET_POSITION_TARGET_LOCAL_NED, .._GLOBAL_INT, SET_ATTITUDE_TARGET.

They have no acknowledgement: a rejected one is reported by a rate-limited STATUSTEXT and ends mode GUIDED.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import development as mav

from autopilot.core import operator_messages as notices
from autopilot.core.frames import rpy_from_quat
from autopilot.core.geodesy import ned_from_geodetic, place_from_ned, refuse_place
from autopilot.core.messages import NavHealth, NavState
from autopilot.mavlink.api import CommandReply, CommandResult, FlightMode, SetPoint
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.vehicle_commands import RELATIVE
from autopilot.mavlink.wire import Message

X, Y, Z, VX, VY, VZ = (1 << bit for bit in range(6))
ACCELERATION = (
    mav.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | mav.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | mav.POSITION_TARGET_TYPEMASK_AZ_IGNORE
)
YAW, YAW_RATE = mav.POSITION_TARGET_TYPEMASK_YAW_IGNORE, mav.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
"""Bits of POSITION_TARGET_TYPEMASK: set = ignore."""

ATTITUDE_ROLL_RATE = mav.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
ATTITUDE_PITCH_RATE = mav.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
ATTITUDE_YAW_RATE = mav.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
ATTITUDE_THRUST = mav.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE
ATTITUDE = mav.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE
MOST_TILT_RAD, MOST_TILT_RATE_RAD_S = 0.1, 0.1
"""Of SET_ATTITUDE_TARGET: clients that send their own attitude back are a little off level; more is meant."""

_OFFSET = frozenset((mav.MAV_FRAME_LOCAL_OFFSET_NED, mav.MAV_FRAME_BODY_NED, mav.MAV_FRAME_BODY_OFFSET_NED, 12))
_BODY = frozenset((mav.MAV_FRAME_BODY_NED, mav.MAV_FRAME_BODY_OFFSET_NED, 12))
"""12: MAV_FRAME_BODY_FRD."""
_LOCAL = _OFFSET | {mav.MAV_FRAME_LOCAL_NED}
_AMSL = frozenset((mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT))

FASTEST = 5.0
"""m/s and rad/s: larger values are errors."""

NEUTRAL_THRUST = 0.5
THRUST_DEADZONE = 0.05
"""SET_ATTITUDE_TARGET.thrust: 0 down, 0.5 holds the depth, 1 up."""


TELL_AGAIN_US = 10_000_000
"""Interval at which a stream of set points that is refused is reported; after a pause as long it is another one."""
_NUMBERS = re.compile(r"[-\d.]+")
"""What differs between the refusals of a stream."""
MAX_REFUSED = 32
"""Clients and reasons that are remembered for that; beyond that the oldest is dropped."""


class _NotFollowedError(Exception):
    """A set point that makes no sense here, and why."""


@dataclass(slots=True)
class _Refused:
    """Set points of one client that were refused for one reason."""

    count: int = 0
    last_us: int = 0
    told_us: int = 0


class SetPoints:
    """Reads them and hands them on."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self._refused: LatestUsed[tuple[MavlinkPeer, str], _Refused] = LatestUsed(MAX_REFUSED)

    def on_local(self, peer: MavlinkPeer, msg: Message) -> None:
        self._take(peer, msg, self._of_local)

    def on_global(self, peer: MavlinkPeer, msg: Message) -> None:
        self._take(peer, msg, self._of_global)

    def on_attitude(self, peer: MavlinkPeer, msg: Message) -> None:
        """SET_ATTITUDE_TARGET: the heading (or its rate) and the vertical part of the thrust."""
        self._take(peer, msg, self._of_attitude)

    def on_actuators(self, peer: MavlinkPeer, msg: Message) -> None:
        """SET_ACTUATOR_CONTROL_TARGET: thrusters belong to the controller."""
        self._refuse(peer, "no actuator control here, send positions or velocities")

    def _take(self, peer: MavlinkPeer, msg: Message, read: Callable[[Message], tuple[SetPoint, bool]]) -> None:
        try:
            point, lasts = read(msg)
        except _NotFollowedError as error:
            self._refuse(peer, str(error))
            return
        ctx = self._ctx
        if lasts and ctx.profile.guided_in_hold and ctx.view.mode is FlightMode.HOLD and ctx.view.armed:
            answer = self._go_to(point)
        else:
            answer = ctx.vehicle.set_point(point)
            if ctx.profile.guided_in_hold and ctx.view.mode is FlightMode.HOLD and ctx.view.armed and not answer.reason:
                answer = ctx.vehicle.set_mode(FlightMode.GUIDED)
        if answer.result is not CommandResult.ACCEPTED and answer.reason:
            self._tell(peer, answer.reason)

    def _refuse(self, peer: MavlinkPeer, reason: str) -> None:
        self._tell(peer, self._ctx.vehicle.refuse_set_point(reason).reason)

    def _tell(self, peer: MavlinkPeer, reason: str) -> None:
        """A refusal in words: of a stream the first, then how many there were."""
        now_us, again_us = self._ctx.t_us, TELL_AGAIN_US * self._ctx.patience
        stream = self._refused.touch((peer, _NUMBERS.sub("", reason)), _Refused)
        if now_us - stream.last_us > again_us:
            stream.count = 0
        stream.count, stream.last_us = stream.count + 1, now_us
        if stream.count > 1 and now_us - stream.told_us < again_us:
            return
        stream.told_us = now_us
        so_far = f" ({stream.count} so far)" if stream.count > 1 else ""
        self._ctx.say(notices.REFUSED(reason=f"{reason}{so_far}"), peer)

    def _go_to(self, point: SetPoint) -> CommandReply:
        """ArduPilot's GUIDED takes a position once and for all, without a stream."""
        nav, origin = self._nav(), self._ctx.view.origin
        north, east = point.place_ned_m or (float(nav.pos_ned_m[0]), float(nav.pos_ned_m[1]))
        depth_m = float(nav.pos_ned_m[2]) if point.depth_m is None else point.depth_m
        place = place_from_ned(origin, north, east, depth_m)
        if place is None:
            return CommandReply(result=CommandResult.DENIED, reason="Set point refused: too far away")
        return self._ctx.vehicle.go_to(place, point.yaw_rad)

    # Reading

    def _of_local(self, msg: Message) -> tuple[SetPoint, bool]:
        frame, mask = msg.coordinate_frame, msg.type_mask
        if frame not in _LOCAL:
            raise _NotFollowedError(f"frame {frame}, use 1 (local), 7 (offset), 8, 9 or 12 (body)")
        place, depth_m = None, None
        planar, vertical = _pair(mask, X, Y, "position"), not mask & Z
        offset, body = frame in _OFFSET, frame in _BODY
        if planar:
            x, y = _finite((msg.x, msg.y), "position")
            place = self._displaced(x, y, body=body) if offset else (x, y)
        if vertical:
            (z,) = _finite((msg.z,), "depth")
            depth_m = z + (float(self._nav().pos_ned_m[2]) if offset else 0.0)
        return self._point(msg, place, depth_m, body=body), not mask & Z or planar

    def _of_global(self, msg: Message) -> tuple[SetPoint, bool]:
        frame, mask, origin = msg.coordinate_frame, msg.type_mask, self._ctx.view.origin
        if frame not in _AMSL and frame not in RELATIVE:
            raise _NotFollowedError(f"frame {frame}, use 0 or 5 (AMSL), 3 or 6 (above the water)")
        place, depth_m = None, None
        if _pair(mask, X, Y, "position"):
            lat_deg, lon_deg = msg.lat_int / 1e7, msg.lon_int / 1e7
            refusal = refuse_place(origin, lat_deg, lon_deg)
            if refusal:
                raise _NotFollowedError(refusal)
            north, east, _ = ned_from_geodetic(origin, lat_deg, lon_deg, origin.alt_m).tolist()
            place = (north, east)
        if not mask & Z:
            (alt,) = _finite((msg.alt,), "altitude")
            depth_m = -alt if frame in RELATIVE else origin.alt_m - alt
        return self._point(msg, place, depth_m, body=False), place is not None or depth_m is not None

    def _point(self, msg: Message, place: tuple[float, float] | None, depth_m: float | None, *, body: bool) -> SetPoint:
        mask = msg.type_mask
        if mask & ACCELERATION != ACCELERATION:
            raise _NotFollowedError("no accelerations here, mask them out")
        moves = _pair(mask, VX, VY, "velocity")
        vel, down = None, None
        if moves and place is None:
            vx, vy = _finite((msg.vx, msg.vy), "velocity")
            vel = (vx, vy)
        if not mask & VZ and depth_m is None:
            (down,) = _finite((msg.vz,), "velocity")
        yaw_rad, rate = None, None
        if not mask & YAW and math.isfinite(msg.yaw):
            yaw_rad = float(msg.yaw) + (float(self._nav().rpy_rad[2]) if body else 0.0)
        elif not mask & YAW_RATE:
            (rate,) = _finite((msg.yaw_rate,), "yaw rate")
        if place is None and depth_m is None and vel is None and down is None and yaw_rad is None and rate is None:
            raise _NotFollowedError(f"type mask {mask} leaves nothing to do")
        return SetPoint(
            until_us=self._until_us(),
            place_ned_m=place,
            vel_m_s=vel,
            body=body,
            depth_m=depth_m,
            down_m_s=down,
            yaw_rad=yaw_rad,
            yaw_rate_rad_s=rate,
        )

    def _of_attitude(self, msg: Message) -> tuple[SetPoint, bool]:
        mask = msg.type_mask
        yaw_rad, rate, down, depth_given = None, None, None, bool(mask & ATTITUDE_THRUST)
        if not mask & ATTITUDE:
            quat = _finite(tuple(msg.q), "attitude", most=math.inf)
            if math.hypot(*quat) < 0.5:
                raise _NotFollowedError("attitude is no quaternion, mask it out")
            roll, pitch, yaw_rad = map(float, rpy_from_quat([each / math.hypot(*quat) for each in quat]))
            if max(abs(roll), abs(pitch)) > MOST_TILT_RAD:
                raise _NotFollowedError("roll and pitch cannot be set, send yaw and thrust")
        elif not mask & ATTITUDE_YAW_RATE:
            (rate,) = _finite((msg.body_yaw_rate,), "yaw rate")
        rates = (ATTITUDE_ROLL_RATE, msg.body_roll_rate), (ATTITUDE_PITCH_RATE, msg.body_pitch_rate)
        if any(not mask & ignored and not abs(each) <= MOST_TILT_RATE_RAD_S for ignored, each in rates):
            raise _NotFollowedError("roll and pitch rates cannot be set, send yaw and thrust")
        if not depth_given:
            (thrust,) = _finite((msg.thrust,), "thrust")
            up = min(max(2.0 * (thrust - NEUTRAL_THRUST), -1.0), 1.0)
            down = None if abs(up) < THRUST_DEADZONE else -up * self._ctx.params["PILOT_SPD_Z"]
        elif yaw_rad is None and rate is None:
            raise _NotFollowedError(f"attitude mask {mask} leaves nothing to do")
        point = SetPoint(until_us=self._until_us(), down_m_s=down, yaw_rad=yaw_rad, yaw_rate_rad_s=rate)
        return point, False

    def _until_us(self) -> int:
        return self._ctx.t_us + round(self._ctx.params["OFFB_TIMEOUT"] * 1e6 * self._ctx.patience)

    def _nav(self) -> NavState:
        nav = self._ctx.view.nav
        if nav is None or nav.health is NavHealth.INVALID:
            raise _NotFollowedError("no position yet")
        return nav

    def _displaced(self, x: float, y: float, *, body: bool) -> tuple[float, float]:
        """An offset (x, y) [m] from the vehicle's position as a local position; ``body``: offset in body axes."""
        nav = self._nav()
        yaw = float(nav.rpy_rad[2]) if body else 0.0
        c, s = math.cos(yaw), math.sin(yaw)
        return float(nav.pos_ned_m[0]) + c * x - s * y, float(nav.pos_ned_m[1]) + s * x + c * y


def _pair(mask: int, one: int, other: int, what: str) -> bool:
    """Whether both of two axes are given; one alone is an error."""
    if bool(mask & one) is not bool(mask & other):
        raise _NotFollowedError(f"{what} needs x and y, or neither")
    return not mask & one


def _finite(values: tuple[float, ...], what: str, *, most: float | None = None) -> tuple[float, ...]:
    """The values, or a refusal if one is not finite or larger than ``most``."""
    bound = 1e6 if what in ("position", "depth", "altitude") else FASTEST if most is None else most
    for value in values:
        if not (math.isfinite(value) and abs(value) <= bound):
            raise _NotFollowedError(f"{what} {value:g} is no usable number")
    return tuple(float(value) for value in values)
