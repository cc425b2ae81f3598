"""Vehicle commands: arm, modes, mission, go-to, speed, home, origin."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from pymavlink.dialects.v20 import development as mav

from autopilot.core import operator_messages as notices
from autopilot.core.frames import wrap_pi
from autopilot.core.geodesy import MAX_ORIGIN_LAT_DEG, GeodeticPosition, far_text, place_from_ned
from autopilot.core.plan import PlanKind
from autopilot.mavlink import home_item
from autopilot.mavlink.api import ACCEPTED, Circling, CommandReply, CommandResult, FlightMode, OrbitYaw
from autopilot.mavlink.commands import Call, CommandRow, Reply, action, denied, request
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.flight_modes import STANDARD_MODES
from autopilot.mavlink.profiles import CUSTOM_MODE_FLAG
from autopilot.mavlink.progress import ProgressMessages
from autopilot.mavlink.telemetry import NavigationMessages
from autopilot.mavlink.wire import Message

FORCE_ARM, FORCE_DISARM = 2989.0, 21196.0
"""COMPONENT_ARM_DISARM.param2: QGroundControl's force arm, and emergency stop (either works both ways)."""

CHANGE_MODE = 1
"""MAV_DO_REPOSITION_FLAGS_CHANGE_MODE."""

NO_ALTITUDE = -0x8000_0000
"""What QGroundControl makes of a place without an altitude, in millimetres."""

_GLOBAL = frozenset((mav.MAV_FRAME_GLOBAL, mav.MAV_FRAME_GLOBAL_INT))
RELATIVE = frozenset((mav.MAV_FRAME_GLOBAL_RELATIVE_ALT, mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT))


_ORBIT_YAW = {
    0: OrbitYaw.TO_CENTRE,
    1: OrbitYaw.INITIAL,
    2: OrbitYaw.FREE,
    3: OrbitYaw.ALONG,
    5: OrbitYaw.FREE,
}
"""ORBIT_YAW_BEHAVIOUR (common.xml); 4 is a pilot's stick, 5 leaves the heading as it is."""

_LASTING = {
    mav.MAV_CMD_NAV_TAKEOFF: FlightMode.TAKEOFF,
    mav.MAV_CMD_DO_ORBIT: FlightMode.CIRCLE,
    mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: FlightMode.RETURN,
    mav.MAV_CMD_NAV_LAND: FlightMode.SURFACE,
    mav.MAV_CMD_MISSION_START: FlightMode.MISSION,
}
"""Commands whose work continues after their answer, in a mode of their own."""

INT_ONLY = CommandReply(result=CommandResult.COMMAND_INT_ONLY, reason="send COMMAND_INT: COMMAND_LONG rounds to 0.5 m")


class VehicleService:
    """Translates commands into requests to the vehicle."""

    def __init__(
        self,
        ctx: Context,
        telemetry: NavigationMessages,
        progress: ProgressMessages,
        report_arming: Callable[[], None],
    ) -> None:
        self._ctx = ctx
        self._telemetry = telemetry
        self._progress = progress
        self._report_arming = report_arming
        """Sends the arming checks as events."""

    def table(self) -> Mapping[int, CommandRow]:

        def here(mode: FlightMode) -> CommandRow:
            return action(lambda call: self.mode_here(call, mode))

        return {
            mav.MAV_CMD_COMPONENT_ARM_DISARM: action(self.arm_disarm),
            mav.MAV_CMD_DO_SET_MODE: action(self.do_set_mode),
            mav.MAV_CMD_DO_SET_STANDARD_MODE: action(self.do_set_standard_mode),
            mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: here(FlightMode.RETURN),
            mav.MAV_CMD_NAV_LAND: here(FlightMode.SURFACE),
            mav.MAV_CMD_NAV_LOITER_UNLIM: here(FlightMode.HOLD),
            mav.MAV_CMD_NAV_TAKEOFF: action(self.take_off),
            mav.MAV_CMD_NAV_GUIDED_ENABLE: action(self.guided_enable),
            mav.MAV_CMD_DO_ORBIT: action(self.orbit),
            mav.MAV_CMD_DO_CHANGE_ALTITUDE: action(self.change_altitude),
            mav.MAV_CMD_MISSION_START: action(self.mission_start),
            mav.MAV_CMD_DO_PAUSE_CONTINUE: action(self.pause_continue),
            mav.MAV_CMD_DO_SET_MISSION_CURRENT: action(self.set_mission_current),
            mav.MAV_CMD_DO_REPOSITION: action(self.reposition),
            mav.MAV_CMD_DO_CHANGE_SPEED: action(self.change_speed),
            mav.MAV_CMD_DO_SET_HOME: action(self.set_home),
            mav.MAV_CMD_DO_SET_GLOBAL_ORIGIN: CommandRow(
                handler=self.set_origin, action=True, carrier=CommandResult.COMMAND_INT_ONLY
            ),
            mav.MAV_CMD_DO_FENCE_ENABLE: action(self.fence_enable),
            mav.MAV_CMD_DO_FLIGHTTERMINATION: action(self.terminate),
            mav.MAV_CMD_RUN_PREARM_CHECKS: request(self.run_prearm_checks),
        }

    # Arming and modes

    def arm_disarm(self, call: Call) -> Reply:
        """COMPONENT_ARM_DISARM: param1 1 = arm, 0 = disarm; param2 = force."""
        force = call.param(2) in (FORCE_ARM, FORCE_DISARM)
        if call.params[0] == 1.0:
            return Reply(self._ctx.vehicle.arm(force))
        if call.params[0] == 0.0:
            return self._disarmed(force)
        return denied(f"arm/disarm: param1 = {call.params[0]:g}, use 1 or 0")

    def _disarmed(self, force: bool) -> Reply:
        vehicle = self._ctx.vehicle
        return Reply(vehicle.disarm(force), later=vehicle.disarmed)

    def terminate(self, call: Call) -> Reply:
        """DO_FLIGHTTERMINATION: stop the thrusters now; irreversible."""
        if call.params[0] == 1.0:
            return self._disarmed(True)
        return denied("flight termination: send param1 = 1")

    def fence_enable(self, call: Call) -> Reply:
        """DO_FENCE_ENABLE: the fence is a constraint of the controller and cannot be disabled."""
        if call.params[0] == 1.0:
            return Reply(ACCEPTED)
        return denied("fence cannot be switched off: disarm and clear it")

    def do_set_mode(self, call: Call) -> Reply:
        """DO_SET_MODE: base mode with the custom flag, then the profile's numbers."""
        base = call.whole(1)
        if base is None or not base & CUSTOM_MODE_FLAG:
            return denied("set mode: send the custom-mode flag (1) and a mode")
        mode = self._ctx.profile.mode_of_command(call.param(2), call.param(3))
        if mode is None:
            return denied(f"no mode {call.param(2):g}/{call.param(3):g}: AVAILABLE_MODES lists them")
        return Reply(self._ctx.vehicle.set_mode(mode))

    def set_mode_message(self, base_mode: int, custom_mode: int) -> CommandReply:
        """Legacy SET_MODE."""
        mode = self._ctx.profile.mode_of(custom_mode) if base_mode & CUSTOM_MODE_FLAG else None
        if mode is None:
            return denied(f"no mode {base_mode}/{custom_mode}: AVAILABLE_MODES lists them").answer
        return self._ctx.vehicle.set_mode(mode)

    def do_set_standard_mode(self, call: Call) -> Reply:
        """DO_SET_STANDARD_MODE; FAILED for a mode that does not exist here (as specified) and for numbers whose
        meaning differs between older and newer clients.
        """
        mode = STANDARD_MODES.get(call.whole(1) or 0)
        if mode is None:
            known = ", ".join(str(n) for n in sorted(STANDARD_MODES))
            reason = f"standard mode {call.param(1):g} is not available: use {known} or DO_SET_MODE"
            return Reply(CommandReply(result=CommandResult.FAILED, reason=reason))
        return Reply(self._ctx.vehicle.set_mode(mode))

    def mode_here(self, call: Call, mode: FlightMode) -> Reply:
        """RETURN, SURFACE and HOLD by command: they begin where the vehicle is."""
        if any(x and x == x for x in (call.x, call.y)) and mode is not FlightMode.RETURN:
            return denied(f"{mode.name.lower()} begins here: go there first")
        return Reply(self._ctx.vehicle.set_mode(mode))

    def run_prearm_checks(self, call: Call) -> Reply:
        """RUN_PREARM_CHECKS: results as text and events; of an armed vehicle only problems of its plans."""
        view = self._ctx.view
        self._report_arming()
        self._ctx.begin_anew()  # a request is answered, however lately the text was sent
        if view.prearm_reasons:
            for reason in view.prearm_reasons:
                self._ctx.say(notices.ARMING_REASON(reason=reason), call.peer)
        elif not view.armed:
            if not view.fenced:
                self._ctx.say(notices.ARMING_UNFENCED(), call.peer)
            self._ctx.say(notices.ARMING_PASSED(), call.peer)
        if view.armed:
            return Reply(
                CommandReply(result=CommandResult.TEMPORARILY_REJECTED, reason="arming checks: the vehicle is armed")
            )
        return Reply(ACCEPTED)

    def cancel(self, command: int) -> bool:
        """Hold if the command being executed is this one. Returns whether it was."""
        ctx = self._ctx
        running = ctx.view.armed and command in _LASTING and ctx.view.mode is _LASTING[command]
        return running and ctx.vehicle.pause().result is CommandResult.ACCEPTED

    # Steering

    def guided_enable(self, call: Call) -> Reply:
        """NAV_GUIDED_ENABLE: param1 > 0.5 = follow set points, else hold."""
        return Reply(self._ctx.vehicle.set_mode(FlightMode.GUIDED if call.param(1) > 0.5 else FlightMode.HOLD))

    def take_off(self, call: Call) -> Reply:
        """NAV_TAKEOFF: dive here. A negative altitude is the depth; a missing or positive one (ground stations for
        aircraft) means TKOFF_DEPTH. COMMAND_LONG has no frame: a depth below the depth band is refused too. param4 is
        the heading [deg], NaN = as it is; so is 0 of a COMMAND_LONG, whose senders fill with it what they do not mean.
        """
        depth_m = self._depth_m(call.z, call.frame)
        if depth_m is None:
            return _unsupported_frame("takeoff", call.frame)
        deepest_m = math.inf if call.exact else self._ctx.params["DEPTH_MAX"]
        given = 0.0 < depth_m <= deepest_m
        yaw_deg = call.params[3]
        turns = math.isfinite(yaw_deg) and (call.exact or yaw_deg != 0.0)
        yaw_rad = wrap_pi(math.radians(yaw_deg)) if turns else None
        return Reply(self._ctx.vehicle.take_off(depth_m if given else None, yaw_rad))

    def change_altitude(self, call: Call) -> Reply:
        """DO_CHANGE_ALTITUDE: param1 altitude, param2 frame."""
        frame = call.whole(2)
        if not math.isfinite(call.params[0]):
            return denied(f"change altitude: {call.params[0]:g} m (param1), give a number")
        depth_m = None if frame is None else self._depth_m(call.params[0], frame)
        if depth_m is None:
            return _unsupported_frame("change altitude", call.param(2))
        return Reply(self._ctx.vehicle.change_depth(depth_m))

    def _depth_m(self, alt_m: float, frame: int) -> float | None:
        """Of an altitude, in LOCAL_NED of a depth; None in another frame, NaN without one."""
        if not math.isfinite(alt_m):
            return math.nan
        if frame == mav.MAV_FRAME_LOCAL_NED:
            return alt_m
        if frame not in _GLOBAL and frame not in RELATIVE:
            return None
        return -alt_m if frame in RELATIVE else self._ctx.view.origin.alt_m - alt_m

    def orbit(self, call: Call) -> Reply:
        """DO_ORBIT: param1 radius (negative = to port), param2 speed, param3 heading, param4 turns; the centre."""
        radius, speed, turns = call.param(1), call.param(2), call.param(4)
        behaviour = call.whole(3)
        if not all(map(math.isfinite, (radius, speed, turns))) or turns < 0.0:
            return denied("orbit: radius, speed and turns have to be numbers, turns at least 0")
        if behaviour not in _ORBIT_YAW:
            return denied(f"orbit: yaw behaviour {call.param(3):g} is not supported, use 0, 1, 2, 3 or 5")
        centre: GeodeticPosition | None = None
        given = any(map(math.isfinite, (call.x, call.y, call.z) if call.exact else (call.x, call.y)))
        if given and (call.x or call.y or call.exact):
            point = self._point(call, "orbit")
            if isinstance(point, Reply):
                return point
            centre = point
        circle = Circling(
            centre=centre,
            depth_held=centre is None or not math.isfinite(call.z),
            radius_m=abs(radius) if radius else None,
            clockwise=radius > 0.0 if radius else None,
            speed_m_s=abs(speed) if speed else None,
            yaw=_ORBIT_YAW[behaviour],
            turns=turns / (2.0 * math.pi),
        )
        return Reply(self._ctx.vehicle.orbit(circle))

    # Mission

    def mission_start(self, call: Call) -> Reply:
        """MISSION_START: param1 = first item (0 = current), param2 = last item (only "all")."""
        by = home_item.shift(self._ctx, PlanKind.MISSION)
        count = len(self._ctx.plans.items(PlanKind.MISSION))
        first, last = call.whole(1), call.whole(2)
        if first is None or first < 0:
            return denied(f"mission start: param1 {call.param(1):g} is no item, use 0 for the current one")
        if last is None or (last > 0 and last < count - 1 + by):
            return denied(f"mission start: param2 {call.param(2):g} ends too early, use 0 for all")
        return Reply(self._ctx.vehicle.start_mission(max(first - by, 0) if first else None))

    def pause_continue(self, call: Call) -> Reply:
        """DO_PAUSE_CONTINUE: 0 = pause, 1 = resume."""
        if call.params[0] == 0.0:
            return Reply(self._ctx.vehicle.pause())
        if call.params[0] == 1.0:
            return Reply(self._ctx.vehicle.resume())
        return denied(f"pause/continue: param1 = {call.params[0]:g}, use 0 or 1")

    def set_mission_current(self, call: Call) -> Reply:
        """DO_SET_MISSION_CURRENT: param1 = item, -1 = the present one; param2 1 = jumps and laps count from 0 again."""
        if not math.isfinite(call.params[0]):
            return denied("set current item: param1 is no number, use an item or -1 for the present one")
        seq = self._progress.wire_seq if call.params[0] == -1.0 else call.params[0]
        return Reply(self._progress.choose(seq, reset=call.param(2) == 1.0))

    # Places

    def reposition(self, call: Call) -> Reply:
        """DO_REPOSITION. No position at all = hold here (QGroundControl's pause); only an altitude = new depth here."""
        ctx = self._ctx
        flags = call.whole(2) or 0
        if not flags & CHANGE_MODE and ctx.view.mode is not FlightMode.HOLD:
            return denied("go-to: set the change-mode flag (param2 = 1)")
        yaw = call.params[3]
        yaw_rad = yaw if math.isfinite(yaw) else None
        placed = any(map(math.isfinite, (call.x, call.y, call.z)))
        point = self._point(call, "go-to") if placed else None
        if isinstance(point, Reply):
            return point
        answer = ctx.vehicle.go_to(point, yaw_rad)
        speed_m_s = call.param(1)
        if placed and answer.result is CommandResult.ACCEPTED and speed_m_s > 0.0:
            speed = ctx.vehicle.change_speed(speed_m_s)
            if speed.reason:
                ctx.say(notices.REFUSED(reason=speed.reason), call.peer)
        return Reply(answer)

    def guided_item(self, peer: MavlinkPeer, msg: Message) -> CommandReply:
        """MISSION_ITEM with current = 2: ArduPilot's go-to, the only one of QGroundControl to an ArduSub. Its 32 bit
        degrees are finer than the map that was clicked on.
        """
        if msg.command != mav.MAV_CMD_NAV_WAYPOINT:
            return denied(f"go-to: command {msg.command} in a MISSION_ITEM with current 2, use NAV_WAYPOINT 16").answer
        change = (-1.0, float(CHANGE_MODE), 0.0, math.nan)
        place = {"x": msg.x, "y": msg.y, "z": msg.z, "frame": msg.frame}
        return self.reposition(Call(peer=peer, command=msg.command, params=change, exact=True, **place)).answer

    def change_speed(self, call: Call) -> Reply:
        """DO_CHANGE_SPEED, ground or water speed alike (both set the cruise speed); -1 = unchanged, -2 = default."""
        if call.whole(1) not in (0, 1):
            return denied(f"change speed: type {call.param(1):g} is not supported, use 0 or 1")
        speed_m_s = call.params[1]
        if speed_m_s == -1.0:
            return Reply(ACCEPTED)
        if speed_m_s == -2.0:
            return Reply(self._ctx.vehicle.change_speed(None))
        if not 0.0 < speed_m_s < math.inf:
            return denied(f"change speed: {speed_m_s:g} m/s, use above 0, -1 (unchanged) or -2 (default)")
        return Reply(self._ctx.vehicle.change_speed(speed_m_s))

    def set_home(self, call: Call) -> Reply:
        """DO_SET_HOME: param1 1 = here, 0 = at the position given."""
        if call.params[0] == 1.0:
            answer = self._ctx.vehicle.set_home(None)
        elif call.param(1) == 0.0:
            point = self._point(call, "set home")
            if isinstance(point, Reply):
                return point
            answer = self._ctx.vehicle.set_home(point)
        else:
            return denied(f"set home: param1 = {call.param(1):g}, use 1 or 0")
        if answer.result is CommandResult.ACCEPTED:
            self._ctx.announce_place = True
        return Reply(answer)

    def set_origin(self, call: Call) -> Reply:
        """DO_SET_GLOBAL_ORIGIN; GPS_GLOBAL_ORIGIN follows whether or not it was taken (common.xml)."""
        self._ctx.announce_place = True
        if call.frame not in _GLOBAL:
            return Reply(CommandReply(result=CommandResult.UNSUPPORTED_FRAME, reason="origin: use frame GLOBAL"))
        if not (math.isfinite(call.x) and math.isfinite(call.y)):
            return denied("origin: latitude or longitude is missing")
        if not math.isfinite(call.z):  # a place of QGroundControl's map has none
            call = replace(call, z=self._ctx.view.origin.alt_m)
        point = self._point(call, "origin")
        return point if isinstance(point, Reply) else Reply(self._ctx.vehicle.set_origin(point))

    def set_origin_message(self, latitude: int, longitude: int, altitude: int) -> CommandReply:
        """SET_GPS_GLOBAL_ORIGIN: 1e-7 degrees and millimetres. Without an altitude that of the origin stays."""
        lat_deg, lon_deg = latitude / 1e7, longitude / 1e7
        alt_m = self._ctx.view.origin.alt_m if altitude == NO_ALTITUDE else altitude / 1e3
        if not _usable(lat_deg, lon_deg):
            return _no_place("origin", lat_deg, lon_deg).answer
        answer = self._ctx.vehicle.set_origin(GeodeticPosition(lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))
        if answer.result is CommandResult.ACCEPTED:
            self._ctx.announce_place = True
        return answer

    def _point(self, call: Call, what: str) -> GeodeticPosition | Reply:
        """Position of a command, or the refusal of an invalid one. Missing coordinates = here."""
        ctx = self._ctx
        given = math.isfinite(call.x)
        if given is not math.isfinite(call.y):
            return denied(f"{what}: latitude or longitude is missing, send both or neither")
        if given and not call.exact:
            return Reply(INT_ONLY)
        if call.frame == mav.MAV_FRAME_LOCAL_NED and given and math.isfinite(call.z):
            place = place_from_ned(ctx.view.origin, call.x, call.y, call.z)
            return denied(f"{what}: {far_text(math.hypot(call.x, call.y))}") if place is None else place
        if call.frame not in _GLOBAL and call.frame not in RELATIVE:
            reason = f"{what}: frame {call.frame} is not supported, use 0, 3 or (with a whole position) 1"
            return Reply(CommandReply(result=CommandResult.UNSUPPORTED_FRAME, reason=reason))
        lat_deg, lon_deg = call.x, call.y
        alt_m = call.z + (ctx.view.origin.alt_m if call.frame in RELATIVE else 0.0)
        if not given or not math.isfinite(call.z):
            here = self._telemetry.here()
            if here is None:
                return denied(f"{what}: no position yet")
            if not given:
                lat_deg, lon_deg = here.lat_deg, here.lon_deg
            if not math.isfinite(call.z):
                alt_m = here.alt_m
        if not _usable(lat_deg, lon_deg):
            return _no_place(what, lat_deg, lon_deg)
        return GeodeticPosition(lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m)


def _unsupported_frame(what: str, frame: float) -> Reply:
    reason = f"{what}: frame {frame:g} is not supported, use 0, 3 or 1"
    return Reply(CommandReply(result=CommandResult.UNSUPPORTED_FRAME, reason=reason))


def _no_place(what: str, lat_deg: float, lon_deg: float) -> Reply:
    """Refuse a position that no local axes can be put at."""
    limits = f"latitude goes to {MAX_ORIGIN_LAT_DEG:g} deg, longitude to 180"
    return denied(f"{what}: {lat_deg:.7f}, {lon_deg:.7f} is no usable position; {limits}")


def _usable(lat_deg: float, lon_deg: float) -> bool:
    """Whether a latitude and longitude can be meant: in range, and not the 0, 0 of fields left empty."""
    return abs(lat_deg) <= MAX_ORIGIN_LAT_DEG and abs(lon_deg) <= 180.0 and (lat_deg != 0.0 or lon_deg != 0.0)
