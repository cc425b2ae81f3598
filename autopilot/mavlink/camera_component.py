"""The camera component (MAV_COMP_ID_CAMERA): https://mavlink.io/en/services/camera.html

Stills only: no video, zoom or focus; one storage, the log folder. It has its own HEARTBEAT and component id. The
autopilot component accepts its commands too, because clients for aircraft send them there.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial

from autopilot.core.frames import quat_from_rpy, r_ned_from_frd, rpy_from_r
from autopilot.core.geodesy import Origin, geodetic_from_ned
from autopilot.core.stills import StillRecord
from autopilot.mavlink.api import ACCEPTED, CameraOrders, CommandResult
from autopilot.mavlink.commands import (
    REPEAT_US,
    UNSUPPORTED,
    Call,
    CommandRow,
    Handler,
    Reply,
    action,
    denied,
    refused,
    request,
)
from autopilot.mavlink.context import COMPID, NAME, Context, MavlinkPeer, i32
from autopilot.mavlink.dialect import command_ids, mav
from autopilot.mavlink.files import LOGS
from autopilot.mavlink.periodic_messages import HEARTBEAT_US
from autopilot.mavlink.status import MAVLINK_VERSION, version_number
from autopilot.mavlink.wire import Message

CAMERA_COMPID: int = mav.MAV_COMP_ID_CAMERA
MIB = 1024.0 * 1024.0
STORAGE = 1
"""Number of the one storage."""
_PHOTO, _VIDEO = mav.CAMERA_MODE_IMAGE, mav.CAMERA_MODE_VIDEO
_IDLE, _TAKING, _SEQUENCE = range(3)
"""CAMERA_CAPTURE_STATUS.image_status: whether a still is being taken, and 2 more in a sequence."""

REQUESTS = command_ids(
    "REQUEST_CAMERA_INFORMATION REQUEST_CAMERA_SETTINGS REQUEST_CAMERA_CAPTURE_STATUS REQUEST_STORAGE_INFORMATION"
    " REQUEST_CAMERA_IMAGE_CAPTURE REQUEST_VIDEO_STREAM_INFORMATION REQUEST_VIDEO_STREAM_STATUS"
)
"""Beside REQUEST_MESSAGE."""

NO_VIDEO = "Camera takes stills only: no video here"
NO_LENS = "Camera has no zoom and no focus to set"


class CameraComponent:
    def __init__(self, ctx: Context, orders: CameraOrders, utc_offset_us: Callable[[], int | None]) -> None:
        """``utc_offset_us``: Unix time minus service time, None while unknown."""
        self._ctx, self._orders, self._utc_offset_us = ctx, orders, utc_offset_us
        self._heartbeat_us = 0
        self._last_single: tuple[MavlinkPeer, int, int] | None = None
        """Client, its number (IMAGE_START_CAPTURE) and time of the last single still: sent again it is the same still.
        Clients count from 1 each time they are started."""

    def tick(self) -> None:
        """HEARTBEAT, and reports of stills taken."""
        ctx = self._ctx
        if ctx.t_us >= self._heartbeat_us:
            self._heartbeat_us = ctx.t_us + HEARTBEAT_US
            ctx.broadcast(self.heartbeat(), CAMERA_COMPID)
        for record in self._orders.take_records():
            ctx.broadcast(self.image_captured(record), CAMERA_COMPID)

    # Commands

    def actions(self) -> Mapping[int, CommandRow]:
        """Commands that the autopilot passes on to its camera as well."""
        return {
            mav.MAV_CMD_IMAGE_START_CAPTURE: action(self.start_capture),
            mav.MAV_CMD_IMAGE_STOP_CAPTURE: action(lambda call: Reply(self._orders.stop())),
            mav.MAV_CMD_DO_DIGICAM_CONTROL: action(self.digicam_control),
            mav.MAV_CMD_DO_DIGICAM_CONFIGURE: refused("Camera has nothing to configure"),
            mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST: action(self.trigger_by_distance),
            mav.MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL: action(self.trigger_by_time),
            mav.MAV_CMD_DO_TRIGGER_CONTROL: action(self.trigger_control),
            mav.MAV_CMD_SET_CAMERA_MODE: action(self.set_mode),
            mav.MAV_CMD_RESET_CAMERA_SETTINGS: action(lambda call: Reply(ACCEPTED)),
            mav.MAV_CMD_SET_CAMERA_ZOOM: refused(NO_LENS),
            mav.MAV_CMD_SET_CAMERA_FOCUS: refused(NO_LENS),
            mav.MAV_CMD_STORAGE_FORMAT: refused("Storage is not formatted: it has the logs, erase those"),
            mav.MAV_CMD_VIDEO_START_CAPTURE: refused(NO_VIDEO),
            mav.MAV_CMD_VIDEO_STOP_CAPTURE: refused(NO_VIDEO),
            mav.MAV_CMD_VIDEO_START_STREAMING: refused(NO_VIDEO),
            mav.MAV_CMD_VIDEO_STOP_STREAMING: refused(NO_VIDEO),
            mav.MAV_CMD_CAMERA_TRACK_POINT: refused("Camera does not track"),
            mav.MAV_CMD_CAMERA_TRACK_RECTANGLE: refused("Camera does not track"),
            mav.MAV_CMD_CAMERA_STOP_TRACKING: refused("Camera does not track"),
            mav.MAV_CMD_DO_CONTROL_VIDEO: refused(NO_VIDEO),
        }

    def requests(self) -> Mapping[int, CommandRow]:
        """Commands that only the camera itself answers: from the autopilot its messages would be another camera's."""

        def fixed(msg_id: int) -> CommandRow:
            return request(lambda call: self._if_requested(call, msg_id))

        return {
            mav.MAV_CMD_REQUEST_MESSAGE: request(self.request_message),
            mav.MAV_CMD_REQUEST_CAMERA_INFORMATION: fixed(mav.MAVLINK_MSG_ID_CAMERA_INFORMATION),
            mav.MAV_CMD_REQUEST_CAMERA_SETTINGS: fixed(mav.MAVLINK_MSG_ID_CAMERA_SETTINGS),
            mav.MAV_CMD_REQUEST_CAMERA_CAPTURE_STATUS: fixed(mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS),
            mav.MAV_CMD_REQUEST_STORAGE_INFORMATION: request(self.storage_request),
            mav.MAV_CMD_REQUEST_CAMERA_IMAGE_CAPTURE: request(lambda call: self._captured(call.whole(1))),
            mav.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION: request(lambda call: denied(NO_VIDEO)),
            mav.MAV_CMD_REQUEST_VIDEO_STREAM_STATUS: request(lambda call: denied(NO_VIDEO)),
        }

    def answers(self, call: Call) -> bool:
        """Whether a broadcast request concerns the camera."""
        if call.command != mav.MAV_CMD_REQUEST_MESSAGE:
            return call.command in REQUESTS
        msg_id = call.whole(1)
        return msg_id != mav.MAVLINK_MSG_ID_HEARTBEAT and (
            msg_id in self._messages() or msg_id == mav.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED
        )

    def start_capture(self, call: Call) -> Reply:
        """IMAGE_START_CAPTURE: param2 interval, param3 count (0 = until stopped), param4 number of a single still."""
        interval_s, count, number = call.param(2), call.whole(3), call.whole(4)
        if count is None or count < 0 or not math.isfinite(interval_s):
            many = f"{call.param(3):g} pictures every {interval_s:g} s"
            return denied(f"Photo refused: {many}, use 1 or more (0 = until stopped) and a finite interval")
        ctx, last = self._ctx, self._last_single
        recent = last is not None and ctx.t_us - last[2] <= REPEAT_US * ctx.patience
        if count == 1 and number and recent and last is not None and last[:2] == (call.peer, number):
            return Reply(ACCEPTED)
        answer = self._orders.shoot(count or None, interval_s)
        if answer.result is CommandResult.ACCEPTED and count == 1:
            self._last_single = (call.peer, number, ctx.t_us) if number else None
        return Reply(answer)

    def digicam_control(self, call: Call) -> Reply:
        """DO_DIGICAM_CONTROL: param5 > 0 takes a still; session, zoom and focus stay as they are."""
        return Reply(self._orders.shoot(1, 0.0)) if call.param5 > 0.0 else Reply(ACCEPTED)

    def trigger_by_distance(self, call: Call) -> Reply:
        """DO_SET_CAM_TRIGG_DIST: param1 distance between stills [m] (0 = stop), param3 = 1: one at once."""
        distance_m = call.param(1)
        if not 0.0 <= distance_m < math.inf:
            return denied(f"Photos refused: every {distance_m:g} m, use more than 0, or 0 to stop")
        return Reply(self._orders.shoot_every(distance_m, now=call.param(3) == 1.0))

    def trigger_by_time(self, call: Call) -> Reply:
        """DO_SET_CAM_TRIGG_INTERVAL: param1 time between stills [ms] (0 = stop)."""
        interval_ms = call.param(1)
        if interval_ms == 0.0:
            return Reply(self._orders.stop())
        if not 0.0 < interval_ms < math.inf:
            return denied(f"Photos refused: every {interval_ms:g} ms, use more than 0, or 0 to stop")
        return Reply(self._orders.shoot(None, interval_ms * 1e-3))

    def trigger_control(self, call: Call) -> Reply:
        """DO_TRIGGER_CONTROL: param1 0 = stop, 1 = resume, -1 = unchanged; resuming needs a new request here."""
        if call.param(1) == 1.0:
            return denied("Photos refused: say how often (IMAGE_START_CAPTURE)")
        return Reply(self._orders.stop() if call.param(1) == 0.0 else ACCEPTED)

    def set_mode(self, call: Call) -> Reply:
        """SET_CAMERA_MODE: param2 0 = stills."""
        mode = call.whole(2)
        if mode in (_PHOTO, mav.CAMERA_MODE_IMAGE_SURVEY):
            return Reply(ACCEPTED)
        return denied(NO_VIDEO if mode == _VIDEO else f"Camera has no mode {call.param(2):g}: use 0, stills")

    # Messages

    def request_message(self, call: Call) -> Reply:
        msg_id = call.whole(1)
        if msg_id == mav.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED:
            return self._captured(call.whole(2))
        build = self._messages().get(-1 if msg_id is None else msg_id)
        return Reply(UNSUPPORTED) if build is None else build(call)

    def storage_request(self, call: Call) -> Reply:
        """REQUEST_STORAGE_INFORMATION: param1 which one, 0 = all; param2 = 1."""
        return self._if_requested(call, mav.MAVLINK_MSG_ID_STORAGE_INFORMATION, which=1, selector=2)

    def _messages(self) -> Mapping[int, Handler]:
        def of(make: Callable[[], Message]) -> Handler:
            return lambda call: Reply(ACCEPTED, (make(),))

        return {
            mav.MAVLINK_MSG_ID_HEARTBEAT: of(self.heartbeat),
            mav.MAVLINK_MSG_ID_CAMERA_INFORMATION: self._introduction,
            mav.MAVLINK_MSG_ID_CAMERA_SETTINGS: of(self.settings),
            mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: of(self.capture_status),
            mav.MAVLINK_MSG_ID_STORAGE_INFORMATION: partial(self._storage, which=2),
        }

    def _introduction(self, call: Call) -> Reply:
        """CAMERA_INFORMATION, preceded by the camera's state: MAVSDK treats the camera as present from that message
        on and requests its state only seconds later.
        """
        status = self.settings(), self.capture_status(), self.storage_information()
        return Reply(ACCEPTED, (*status, self.information()))

    def _if_requested(self, call: Call, msg_id: int, *, which: int | None = None, selector: int = 1) -> Reply:
        """The older request commands: a parameter of 1 requests the message."""
        if call.param(selector) != 1.0:
            return Reply(ACCEPTED)
        if which is not None:
            return self._storage(call, which=which)
        return self._messages()[msg_id](call)

    def _storage(self, call: Call, *, which: int) -> Reply:
        if call.whole(which) not in (0, STORAGE):
            return denied(f"Storage {call.param(which):g} does not exist: there is one, 1")
        return Reply(ACCEPTED, (self.storage_information(),))

    def _captured(self, index: int | None) -> Reply:
        record = None if index is None else self._orders.record(index)
        if record is None:
            return denied(f"There is no photo {'?' if index is None else index}")
        return Reply(ACCEPTED, (self.image_captured(record),))

    def heartbeat(self) -> Message:
        return mav.MAVLink_heartbeat_message(
            mav.MAV_TYPE_CAMERA, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, MAVLINK_VERSION
        )

    def information(self) -> Message:
        """CAMERA_INFORMATION: focal length and sensor size are not known in millimetres."""
        ctx, identity = self._ctx, self._orders.identity
        major, minor, patch, _ = version_number(ctx.identity.version, (0, 0, 0)).to_bytes(4, "big")
        return mav.MAVLink_camera_information_message(
            ctx.boot_ms,
            _text(NAME, 32),
            _text(f"{identity.vehicle} camera", 32),
            major | minor << 8 | patch << 16,
            math.nan,
            math.nan,
            math.nan,
            identity.width_px,
            identity.height_px,
            0,
            mav.CAMERA_CAP_FLAGS_CAPTURE_IMAGE,
            0,
            b"",
        )

    def settings(self) -> Message:
        """CAMERA_SETTINGS: stills; neither zoom nor focus."""
        return mav.MAVLink_camera_settings_message(self._ctx.boot_ms, _PHOTO, math.nan, math.nan)

    def capture_status(self) -> Message:
        state = self._orders.state
        free = 0 if state.report is None else state.report.free_bytes
        running = state.interval_s is not None or state.distance_m is not None
        status = (_SEQUENCE if running else _IDLE) + (_TAKING if state.exposing else _IDLE)
        return mav.MAVLink_camera_capture_status_message(
            self._ctx.boot_ms, status, 0, state.interval_s or 0.0, 0, free / MIB, i32(state.count)
        )

    def storage_information(self) -> Message:
        """STORAGE_INFORMATION: the disk that the logs go to."""
        report = self._orders.state.report
        known = report is not None and report.total_bytes > 0
        total, free = (report.total_bytes, report.free_bytes) if report is not None else (0, 0)
        status = mav.STORAGE_STATUS_READY if known else mav.STORAGE_STATUS_NOT_SUPPORTED
        return mav.MAVLink_storage_information_message(
            self._ctx.boot_ms,
            STORAGE,
            1,
            status,
            total / MIB,
            (total - free) / MIB,
            free / MIB,
            math.nan,
            math.nan,
            mav.STORAGE_TYPE_OTHER,
            b"logs",
            mav.STORAGE_USAGE_FLAG_SET | mav.STORAGE_USAGE_FLAG_PHOTO | mav.STORAGE_USAGE_FLAG_LOGS,
        )

    def image_captured(self, record: StillRecord) -> Message:
        """CAMERA_IMAGE_CAPTURED: position of the vehicle and attitude of the camera at the exposure; 0 when unknown."""
        ctx, still = self._ctx, record.still
        offset_us = self._utc_offset_us()
        origin = ctx.view.origin
        lat_e7 = lon_e7 = alt_mm = relative_mm = 0
        quaternion = [math.nan] * 4
        if record.pos_ned_m is not None and record.rpy_rad is not None:
            place = Origin(lat_deg=origin.lat_deg, lon_deg=origin.lon_deg, alt_m=origin.alt_m)
            lat, lon, alt = geodetic_from_ned(place, record.pos_ned_m)
            lat_e7, lon_e7, alt_mm = i32(lat * 1e7), i32(lon * 1e7), i32(alt * 1e3)
            relative_mm = i32((alt - ctx.view.home.alt_m) * 1e3)
            r_ned_from_view = r_ned_from_frd(record.rpy_rad) @ self._orders.identity.r_frd_from_view
            quaternion = quat_from_rpy(rpy_from_r(r_ned_from_view)).tolist()
        # The autopilot has the files, not the camera.
        url = f"mftp://[;comp={COMPID}]/{LOGS}/{still.path}" if still.path else ""
        return mav.MAVLink_camera_image_captured_message(
            (still.exposure_us // 1000) & 0xFFFF_FFFF,
            0 if offset_us is None else still.exposure_us + offset_us,
            0,
            lat_e7,
            lon_e7,
            alt_mm,
            relative_mm,
            quaternion,
            still.index,
            0 if still.problem else 1,
            url.encode("ascii", errors="replace")[:204],
        )


def _text(text: str, size: int) -> list[int]:
    return list(text.encode("ascii", errors="replace")[:size].ljust(size, b"\0"))
