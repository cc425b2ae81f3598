"""High latency links: https://mavlink.io/en/services/high_latency.html

MAV_CMD_CONTROL_HIGH_LATENCY switches the link on which it arrives. In high latency mode HEARTBEAT, telemetry and
texts except those of failsafes are suppressed there and replaced by HIGH_LATENCY2 every few seconds; requests are
answered as usual. A link with other peers is not switched, and a new peer on the link ends the mode, because it
waits for a HEARTBEAT.
"""

import math
from collections.abc import Mapping

from autopilot.core import operator_messages as notices
from autopilot.core.messages import Failsafe, NavDoubt, NavHealth
from autopilot.core.model4 import YAW
from autopilot.core.samples import HullSample
from autopilot.mavlink.api import ACCEPTED
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.commands import Call, Reply, denied
from autopilot.mavlink.context import Context, i32, limited, u16
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.inbox import Address
from autopilot.mavlink.progress import ProgressMessages
from autopilot.mavlink.status import StatusMessages
from autopilot.mavlink.streams import Streams
from autopilot.mavlink.telemetry import SANE, Builder, NavigationMessages
from autopilot.mavlink.wire import Message

INTERVAL_US = 5_000_000
"""Interval of HIGH_LATENCY2; SET_MESSAGE_INTERVAL changes it."""
OTHERS_US = 5_000_000
"""Time without messages after which a client no longer uses a link."""
MAX_ADDRESSES = 64

_FLAGS: Mapping[Failsafe, int] = {
    Failsafe.NAV_LOST: mav.HL_FAILURE_FLAG_ESTIMATOR,
    Failsafe.NAV_CHECK: mav.HL_FAILURE_FLAG_ESTIMATOR,
    Failsafe.DEAD_RECKONING: mav.HL_FAILURE_FLAG_GPS,
    Failsafe.BATTERY: mav.HL_FAILURE_FLAG_BATTERY,
    Failsafe.BATTERY_CRITICAL: mav.HL_FAILURE_FLAG_BATTERY,
    Failsafe.ENERGY: mav.HL_FAILURE_FLAG_BATTERY,
    Failsafe.AHRS_STALE: mav.HL_FAILURE_FLAG_3D_GYRO | mav.HL_FAILURE_FLAG_3D_ACCEL,
    Failsafe.THRUSTER: mav.HL_FAILURE_FLAG_ENGINE,
    Failsafe.CAGE_SOFT: mav.HL_FAILURE_FLAG_GEOFENCE,
    Failsafe.CAGE_HARD: mav.HL_FAILURE_FLAG_GEOFENCE,
    Failsafe.GCS: mav.HL_FAILURE_FLAG_OFFBOARD_LINK,
    Failsafe.PILOT: mav.HL_FAILURE_FLAG_RC_RECEIVER,
}
_DOUBTS: Mapping[NavDoubt, int] = {
    NavDoubt.ACCELEROMETER: mav.HL_FAILURE_FLAG_3D_ACCEL,
    NavDoubt.GYRO: mav.HL_FAILURE_FLAG_3D_GYRO,
}


class HighLatency:
    """Set of links in high latency mode, and their HIGH_LATENCY2."""

    def __init__(
        self,
        ctx: Context,
        streams: Streams,
        status: StatusMessages,
        telemetry: NavigationMessages,
        progress: ProgressMessages,
    ) -> None:
        self._ctx, self._streams, self._status = ctx, streams, status
        self._telemetry, self._progress = telemetry, progress
        self._received_us: LatestUsed[Address, int] = LatestUsed(MAX_ADDRESSES)
        """Time of the last message of each client."""
        self._owners: dict[int, int] = {}
        """Client that made a link such a one."""
        self._climb_m_s = self._across_m = self._deep_m = 0.0
        """Maxima since the last message, as HIGH_LATENCY2 specifies."""

    def builders(self) -> Mapping[int, Builder]:
        return {mav.MAVLINK_MSG_ID_HIGH_LATENCY2: self.high_latency2}

    def control(self, call: Call) -> Reply:
        """CONTROL_HIGH_LATENCY: param1 1 = enable, 0 = disable on this link."""
        link, wanted = call.peer.link, call.params[0]
        if wanted not in (0.0, 1.0):
            return denied(f"high latency: param1 = {wanted:g}, use 1 or 0")
        if wanted == 0.0:
            self.end(link)
            return Reply(ACCEPTED)
        if self._others(link, call.peer.client):
            return denied("High latency refused: others use this link")
        if link not in self._owners:
            self._owners[link] = call.peer.client
            self._ctx.quiet.add(link)
            self._streams.only(link, mav.MAVLINK_MSG_ID_HIGH_LATENCY2, INTERVAL_US)
            self._ctx.log(notices.HIGH_LATENCY(link=link))
        return Reply(ACCEPTED)

    def note_frame(self, address: Address) -> None:
        """A good frame of a client."""
        link, client = address
        self._received_us[address] = self._ctx.t_us
        if self._owners.get(link, client) != client:
            self.end(link)

    def forget(self, link: int) -> None:
        self._owners.pop(link, None)
        self._ctx.quiet.discard(link)
        for address in [address for address in self._received_us if address[0] == link]:
            del self._received_us[address]

    def _others(self, link: int, client: int) -> bool:
        since_us = self._ctx.t_us - OTHERS_US * self._ctx.patience
        return any(
            at_us >= since_us for (its, who), at_us in self._received_us.items() if its == link and who != client
        )

    def end(self, link: int) -> None:
        """The link is a common one again, if it was not."""
        if self._owners.pop(link, None) is None:
            return
        self._ctx.quiet.discard(link)
        self._streams.all_again(link)
        self._ctx.send(link, self._status.heartbeat())
        self._ctx.log(notices.HIGH_LATENCY_OVER(link=link))

    def tick(self) -> None:
        """Update the maxima that are reported since the last message."""
        nav, motion = self._ctx.view.nav, self._telemetry.motion()
        if nav is None or motion is None:
            return
        var = [min(max(x, 0.0), SANE) for x in nav.variance[:3].tolist()]
        self._climb_m_s = max(self._climb_m_s, abs(motion.vd))
        self._across_m = max(self._across_m, math.sqrt(var[0] + var[1]))
        self._deep_m = max(self._deep_m, math.sqrt(var[2]))

    def high_latency2(self) -> Message | None:
        """HIGH_LATENCY2. Wind is the current, as it flows; the air is that in the hull; custom0
        is HEARTBEAT.base_mode, custom1 the depth in decimetres, 127 = deeper."""
        ctx, view, beat = self._ctx, self._ctx.view, self._status.heartbeat()
        motion, here, target = self._telemetry.motion(), self._telemetry.here(), view.target_ned_m
        lat_e7 = lon_e7 = alt_m = heading = ground = water_speed = wind = wind_to = depth_dm = distance_dam = 0
        eph = epv = 0xFF
        if motion is not None and here is not None and view.nav is not None:
            lat_e7, lon_e7, alt_m = i32(here.lat_deg * 1e7), i32(here.lon_deg * 1e7), limited(here.alt_m, -32768, 32767)
            heading = _half_deg(math.radians(motion.heading_deg))
            ground, water_speed = _speed(math.hypot(motion.vn, motion.ve)), _speed(motion.water_speed)
            north, east = (x if abs(x) < SANE else 0.0 for x in view.nav.current_ned_m_s[:2].tolist())
            wind, wind_to = _speed(math.hypot(north, east)), _half_deg(math.atan2(east, north))
            eph, epv = limited(10.0 * self._across_m, 0, 255), limited(10.0 * self._deep_m, 0, 255)
            depth_dm = limited(10.0 * motion.down, -128, 127)
            if target is not None:
                distance_dam = u16(0.1 * math.dist(target.tolist(), (motion.north, motion.east, motion.down)))
        hull, power = view.sensed.of(HullSample), view.power
        warm_c = 0.0 if hull is None or hull.temperature_c is None else hull.temperature_c
        climb_dm_s = limited(10.0 * self._climb_m_s, 0, 127)
        self._climb_m_s = self._across_m = self._deep_m = 0.0
        return mav.MAVLink_high_latency2_message(
            ctx.boot_ms,
            beat.type,
            beat.autopilot,
            ctx.profile.short_mode(beat.custom_mode),
            lat_e7,
            lon_e7,
            alt_m,
            alt_m if target is None else limited(view.origin.alt_m - float(target[2]), -32768, 32767),
            heading,
            self._target_heading(heading),
            distance_dam,
            self._telemetry.throttle_percent(),
            water_speed,
            0,
            ground,
            wind,
            wind_to,
            eph,
            epv,
            limited(warm_c, -128, 127),
            climb_dm_s,
            -1 if power is None else limited(100.0 * power.remaining, 0, 100),
            self._progress.wire_seq,
            self._failures(),
            beat.base_mode - 256 if beat.base_mode > 127 else beat.base_mode,
            depth_dm,
            0,
        )

    def _target_heading(self, heading: int) -> int:
        """Heading at the end of the controller's prediction; the present one without control."""
        ahead = self._ctx.view.ahead
        yaw = math.nan if ahead is None else float(ahead[-1, YAW])
        return _half_deg(yaw) if math.isfinite(yaw) else heading

    def _failures(self) -> int:
        view = self._ctx.view
        flags = 0
        for failsafe, bits in _FLAGS.items():
            flags |= bits if view.failsafes >> failsafe & 1 else 0
        for doubt, bits in _DOUBTS.items():
            flags |= bits if doubt in view.nav_doubts else 0
        if view.nav is None or view.nav.health is NavHealth.INVALID:
            flags |= mav.HL_FAILURE_FLAG_GPS | mav.HL_FAILURE_FLAG_ESTIMATOR
        if view.power is not None and view.power.remaining < self._ctx.params["FS_BATT_LOW"]:
            flags |= mav.HL_FAILURE_FLAG_BATTERY
        return flags


def _half_deg(rad: float) -> int:
    """An angle as HIGH_LATENCY2 has it: whole numbers of 2 deg, 0 to 179."""
    return round(math.degrees(rad) / 2.0) % 180


def _speed(m_s: float) -> int:
    """As HIGH_LATENCY2 has it: 0.2 m/s."""
    return limited(5.0 * m_s, 0, 255)
