"""Gimbal protocol of a camera that tilts (https://mavlink.io/en/services/gimbal_v2.html), and the older mount commands.

The tilt is an output of ``[[payload]]`` without stabilisation: angles are against the body, upwards positive. Without
one the commands are refused and the messages are not sent.
"""

import math
from collections.abc import Mapping

from autopilot.mavlink.api import ACCEPTED, EquipmentOrders
from autopilot.mavlink.commands import Call, CommandRow, Reply, action, denied
from autopilot.mavlink.context import Context
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.telemetry import Builder
from autopilot.mavlink.wire import Message

DEVICE_ID = 1
"""Of a gimbal without a component of its own: 1 to 6."""
CAPABILITIES = (
    mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_NEUTRAL
    | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS
    | mav.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_FOLLOW
)
TO_SENDER, RELEASED = -2, -3
"""Special system ids of DO_GIMBAL_MANAGER_CONFIGURE."""


class Gimbal:
    def __init__(self, ctx: Context, orders: EquipmentOrders | None) -> None:
        """``orders``: None = nothing is carried."""
        self._ctx, self._carried = ctx, orders
        self._primary = (0, 0)
        """System and component that have asked for control; everybody may tilt all the same."""

    def builders(self) -> Mapping[int, Builder]:
        return {
            mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: self.manager_information,
            mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: self.manager_status,
            mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: self.attitude_status,
        }

    def table(self) -> Mapping[int, CommandRow]:
        if self._carried is None:
            return {}
        return {
            mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: action(self.pitch_yaw),
            mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: action(self.configure),
            mav.MAV_CMD_DO_MOUNT_CONFIGURE: action(self.mount_configure),
            mav.MAV_CMD_DO_MOUNT_CONTROL: action(self.mount_control),
        }

    @property
    def _orders(self) -> EquipmentOrders:
        assert self._carried is not None, "commands are in the table only with it"
        return self._carried

    @property
    def _ends_rad(self) -> tuple[float, float] | None:
        """Lower and upper end of the tilt, None without one."""
        return None if self._carried is None else self._carried.tilt_range_rad

    # Commands

    def pitch_yaw(self, call: Call) -> Reply:
        """DO_GIMBAL_MANAGER_PITCHYAW: param1 angle [deg], param5 flags (1 retract, 2 neutral: its start)."""
        flags = int(call.param5) if 0.0 <= call.param5 < 2.0**31 else 0
        if flags & (mav.GIMBAL_MANAGER_FLAGS_RETRACT | mav.GIMBAL_MANAGER_FLAGS_NEUTRAL):
            return Reply(self._orders.tilt_by(None))
        if math.isnan(call.params[0]):
            return self._unless_fixed("Tilt refused: it takes an angle (param1), no rate")
        if abs(call.param(2)) > 0.0:
            return self._unless_fixed(f"Tilt refused: yaw {call.param(2):g} deg, the camera does not pan")
        return Reply(self._orders.tilt(math.radians(call.params[0])))

    def mount_control(self, call: Call) -> Reply:
        """DO_MOUNT_CONTROL: param1 angle [deg], param7 mode 2 (angle), or 0 or 1 (its start)."""
        if call.z in (mav.MAV_MOUNT_MODE_RETRACT, mav.MAV_MOUNT_MODE_NEUTRAL):
            return Reply(self._orders.tilt_by(None))
        if call.z != mav.MAV_MOUNT_MODE_MAVLINK_TARGETING and not math.isnan(call.z):
            return self._unless_fixed(f"Tilt refused: mode {call.z:g} (param7), use 2 (angle) or 1 (neutral)")
        return Reply(self._orders.tilt(math.radians(call.param(1))))

    def mount_configure(self, call: Call) -> Reply:
        """DO_MOUNT_CONFIGURE: only the mode that there is, 2 (by command)."""
        if call.param(1) != mav.MAV_MOUNT_MODE_MAVLINK_TARGETING:
            return self._unless_fixed(f"Tilt refused: mode {call.param(1):g}, use 2 (by command)")
        return self._unless_fixed("")

    def configure(self, call: Call) -> Reply:
        """DO_GIMBAL_MANAGER_CONFIGURE: param1, param2 who has control."""
        system, component = call.whole(1), call.whole(2)
        if system == TO_SENDER:
            self._primary = (call.peer.sysid, call.peer.compid)
        elif system == RELEASED:
            self._primary = (0, 0)
        elif system is not None and 0 <= system < 256 and component is not None and 0 <= component < 256:
            self._primary = (system, component)
        return self._unless_fixed("")

    def _unless_fixed(self, reason: str) -> Reply:
        """The reason, or accepted where it is ""; with no tilt that is the reason."""
        refusal = self._orders.refuse_tilt() or reason
        return denied(refusal) if refusal else Reply(ACCEPTED)

    # Messages

    def manager_information(self) -> Message | None:
        """GIMBAL_MANAGER_INFORMATION: the ends of the tilt."""
        ends = self._ends_rad
        if ends is None:
            return None
        return mav.MAVLink_gimbal_manager_information_message(
            self._ctx.boot_ms, CAPABILITIES, DEVICE_ID, 0.0, 0.0, ends[0], ends[1], 0.0, 0.0
        )

    def manager_status(self) -> Message | None:
        """GIMBAL_MANAGER_STATUS: who has asked for control."""
        if self._ends_rad is None:
            return None
        return mav.MAVLink_gimbal_manager_status_message(self._ctx.boot_ms, 0, DEVICE_ID, *self._primary, 0, 0)

    def attitude_status(self) -> Message | None:
        """GIMBAL_DEVICE_ATTITUDE_STATUS: the angle that the tilt has by the pulse at its servo."""
        angle_rad = None if self._carried is None else self._carried.tilt_rad
        if angle_rad is None:
            return None
        q = [math.cos(0.5 * angle_rad), 0.0, math.sin(0.5 * angle_rad), 0.0]
        nan = math.nan
        in_vehicle = mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
        return mav.MAVLink_gimbal_device_attitude_status_message(
            0, 0, self._ctx.boot_ms, in_vehicle, q, nan, nan, nan, 0, gimbal_device_id=DEVICE_ID
        )
