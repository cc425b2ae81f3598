"""Table of the supported mission items: one row per command, for the parser and the documentation.

A new command is a new row: its data are a class of :mod:`autopilot.mission.items`, its execution is in
:mod:`autopilot.mission.sequencer`. ``python docs/mission_items.py --write`` updates the table of docs/mavlink.md.
"""

from collections.abc import Callable
from dataclasses import dataclass

from autopilot.core.geodesy import Origin
from autopilot.core.plan import MissionResult, PlanItem
from autopilot.mission import flight_items, payload_items
from autopilot.mission.decode import refuse
from autopilot.mission.items import GLOBAL_FRAMES, Command, MavFrame, NoOp, Step


@dataclass(frozen=True, slots=True)
class ItemType:
    """One command that a mission may hold."""

    command: Command
    parse: Callable[[PlanItem, Origin], Step]
    """ItemRefusedError when the item cannot be flown."""
    uses: str
    """Fields used, for the documentation (Markdown)."""
    placed: bool = False
    """Its frame is judged with its position."""


_ROWS = (
    ItemType(
        Command.NAV_WAYPOINT,
        flight_items.goto,
        "p1 hold [s], p2 acceptance radius [m] (0 = `WP_ACCEPT_RADIUS`, else at least 0.02), p3 must be 0, p4 yaw",
        placed=True,
    ),
    ItemType(Command.NAV_LOITER_UNLIM, flight_items.loiter, "p4 yaw; position 0, 0 or frame 2 = here", placed=True),
    ItemType(
        Command.NAV_LOITER_TURNS,
        flight_items.circuit,
        "p1 turns, p3 radius [m] (negative = to port, 0 = `CIRCLE_RADIUS`); speed as last set or `CIRCLE_SPEED`; "
        "heading to the centre; position as 17; the whole circle must be clear of the fence",
        placed=True,
    ),
    ItemType(Command.NAV_LOITER_TIME, flight_items.loiter, "p1 time [s]; position as 17", placed=True),
    ItemType(
        Command.NAV_RETURN_TO_LAUNCH,
        flight_items.return_home,
        "home at the depth of the goal before; ends the mission",
    ),
    ItemType(
        Command.NAV_LAND,
        flight_items.surface,
        "surfaces there (or here), disarms, ends the mission; altitude unused",
        placed=True,
    ),
    ItemType(
        Command.NAV_TAKEOFF,
        flight_items.take_off,
        "p4 yaw; dives in place; an altitude in the water is the depth, one above it means `TKOFF_DEPTH`; position"
        " unused",
    ),
    ItemType(Command.NAV_DELAY, flight_items.wait, "p1 [s] without pauses; a time of day is refused"),
    ItemType(Command.CONDITION_DELAY, flight_items.wait, "as 93, without a MISSION_ITEM_REACHED"),
    ItemType(
        Command.CONDITION_DISTANCE,
        flight_items.near,
        "p1 [m]: the following DO_ items wait until the next place is so near",
    ),
    ItemType(
        Command.CONDITION_YAW,
        flight_items.set_heading,
        "p1 heading [deg], p3 -1 = to port, p4 1 = relative; for later goals without a heading, at once for a "
        "delay that follows",
    ),
    ItemType(
        Command.CONDITION_GATE,
        flight_items.gate,
        "as 114, until the plane through this place across the path is passed; p1 0, p2 1 = its altitude counts",
        placed=True,
    ),
    ItemType(Command.DO_JUMP, flight_items.jump, "p1 item, p2 repeats (-1 = for ever)"),
    ItemType(
        Command.DO_CHANGE_SPEED,
        flight_items.change_speed,
        "p1 0 or 1, p2 speed over ground [m/s], at most `SPD_PLANAR_MAX`; -2 = `SPD_CRUISE` again",
    ),
    ItemType(Command.DO_SET_HOME, flight_items.set_home, "p1 1 = here"),
    ItemType(
        Command.DO_SET_ROI_LOCATION,
        flight_items.look_at,
        "heading to this place from here on (altitude unused); headings of waypoints do not count",
        placed=True,
    ),
    ItemType(Command.DO_SET_ROI_NONE, flight_items.look_at, "ends that"),
    ItemType(Command.DO_SET_ROI, flight_items.look_at, "p1 3 or 0; as 195; position 0, 0 = as 197", placed=True),
    ItemType(
        Command.DO_FENCE_ENABLE,
        flight_items.fence_on,
        "p1 1; 0 and 2 are refused: a mission cannot switch the fence off",
    ),
    ItemType(
        Command.IMAGE_START_CAPTURE,
        payload_items.start_capture,
        "p2 interval [s], at least 0.2; p3 count (0 = until stopped)",
    ),
    ItemType(Command.IMAGE_STOP_CAPTURE, payload_items.stop_capture, "ends stills by time and by distance"),
    ItemType(
        Command.DO_SET_CAM_TRIGG_DIST,
        payload_items.trigger_by_distance,
        "p1 distance between stills [m], 0 = stop; p3 1 = the first at once",
    ),
    ItemType(Command.DO_SET_CAM_TRIGG_INTERVAL, payload_items.trigger_by_time, "p1 time between stills [ms], 0 = stop"),
    ItemType(Command.DO_DIGICAM_CONTROL, payload_items.digicam_control, "p5 above 0: one still"),
    ItemType(Command.SET_CAMERA_MODE, payload_items.camera_mode, "p2 0 or 2 (stills)"),
    ItemType(Command.DO_SET_SERVO, payload_items.set_servo, "p1 output, p2 pulse [us]"),
    ItemType(
        Command.DO_REPEAT_SERVO,
        payload_items.repeat_servo,
        "p1 output, p2 pulse [us], p3 cycles, p4 cycle time [s]",
    ),
    ItemType(Command.DO_SET_RELAY, payload_items.set_relay, "p1 relay from 0, p2 1 = on, 0 = off, -1 = toggle"),
    ItemType(Command.DO_REPEAT_RELAY, payload_items.repeat_relay, "p1 relay, p2 cycles, p3 cycle time [s]"),
    ItemType(Command.DO_GRIPPER, payload_items.gripper, "p1 gripper from 1 (0 = the first), p2 0 = open, 1 = close"),
    ItemType(
        Command.DO_SET_ACTUATOR,
        payload_items.set_actuator,
        "p1 to p4 actuators 1 to 4, -1 to 1, NaN = unchanged; z 1 = actuators 7 to 10",
    ),
    ItemType(
        Command.DO_MOUNT_CONTROL, payload_items.mount_control, "p1 camera tilt [deg], up positive; z 2 (1 = its start)"
    ),
    ItemType(
        Command.DO_GIMBAL_MANAGER_PITCHYAW, payload_items.gimbal_pitch, "p1 camera tilt [deg], up positive; p2 yaw 0"
    ),
    *(
        ItemType(command, payload_items.refused(why), f"refused: {why}")
        for command, why in (
            (Command.VIDEO_START_CAPTURE, "the camera takes stills only"),
            (Command.VIDEO_STOP_CAPTURE, "the camera takes stills only"),
            (Command.SET_CAMERA_ZOOM, "the camera has no zoom"),
            (Command.SET_CAMERA_FOCUS, "the camera has no focus"),
            (Command.DO_DIGICAM_CONFIGURE, "the camera has nothing to configure"),
            (Command.DO_MOUNT_CONFIGURE, "the tilt has nothing to configure"),
        )
    ),
)

ITEM_TYPES: dict[int, ItemType] = {int(row.command): row for row in _ROWS}
"""By MAV_CMD, in the order of the documentation."""

_KNOWN = "NAV_WAYPOINT 16, NAV_DELAY 93"
"""What most plans need, for refusals."""


def parse_step(item: PlanItem, origin: Origin) -> Step:
    """Typed step of a mission item; ItemRefusedError if it cannot be flown."""
    if item.is_home:
        return NoOp(seq=item.seq)
    found = ITEM_TYPES.get(item.command)
    if found is None:
        text = f"command {item.command} is not supported in a mission; use {_KNOWN}, ... (docs/mavlink.md)"
        raise refuse(item, MissionResult.UNSUPPORTED, text)
    if not found.placed and item.frame not in GLOBAL_FRAMES | {MavFrame.LOCAL_NED, MavFrame.MISSION}:
        text = f"frame {item.frame} is not supported for command {item.command}; use frame 2 (MISSION)"
        raise refuse(item, MissionResult.UNSUPPORTED_FRAME, text)
    return found.parse(item, origin)


def table() -> str:
    """The rows as a Markdown table."""
    lines = ["| command | parameters used |", "| --- | --- |"]
    lines += [f"| {row.command.name} {int(row.command)} | {row.uses} |" for row in ITEM_TYPES.values()]
    return "\n".join(lines)
