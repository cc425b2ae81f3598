"""The mission items that can be flown: one row per command, read by the parser and by the documentation.

A row more is a command more: what it asks for is a class of :mod:`autopilot.mission.items`, what it does stands in
:mod:`autopilot.mission.sequencer`. ``python docs/mission_items.py --write`` updates the table of docs/mavlink.md.
"""

from collections.abc import Callable
from dataclasses import dataclass

from autopilot.core.geodesy import Origin
from autopilot.core.plan import MissionResult, PlanItem
from autopilot.mission import do_items, nav_items, payload_items
from autopilot.mission.decode import refuse
from autopilot.mission.items import GLOBAL_FRAMES, Agreed, Command, MavFrame, Step


@dataclass(frozen=True, slots=True, kw_only=True)
class ItemType:
    """One command that a mission may hold."""

    command: Command
    parse: Callable[[PlanItem, Origin], Step]
    """ItemRefusedError when the item cannot be flown."""
    uses: str
    """What of it is used, for the documentation (Markdown)."""
    placed: bool = False
    """Its frame is judged with its position."""


_ROWS = (
    ItemType(
        command=Command.NAV_WAYPOINT,
        parse=nav_items.goto,
        uses="p1 hold [s], p2 acceptance radius [m] (0 = `WP_ACCEPT_RADIUS`, else at least 0.02), p3 must be 0, p4 yaw",
        placed=True,
    ),
    ItemType(
        command=Command.NAV_LOITER_UNLIM,
        parse=nav_items.loiter,
        uses="p4 yaw; position 0, 0 or frame 2 = here",
        placed=True,
    ),
    ItemType(
        command=Command.NAV_LOITER_TURNS,
        parse=nav_items.circuit,
        uses=(
            "p1 turns, p3 radius [m] (negative = to port, 0 = `CIRCLE_RADIUS`); speed as last set or "
            "`CIRCLE_SPEED`; heading to the centre; position as 17; the whole circle must be clear of the fence"
        ),
        placed=True,
    ),
    ItemType(
        command=Command.NAV_LOITER_TIME,
        parse=nav_items.loiter,
        uses="p1 time [s]; position as 17",
        placed=True,
    ),
    ItemType(
        command=Command.NAV_RETURN_TO_LAUNCH,
        parse=nav_items.return_home,
        uses="home at the depth of the goal before; ends the mission",
    ),
    ItemType(
        command=Command.NAV_LAND,
        parse=nav_items.surface,
        uses="surfaces there (or here), disarms, ends the mission; altitude unused",
        placed=True,
    ),
    ItemType(
        command=Command.NAV_TAKEOFF,
        parse=nav_items.take_off,
        uses=(
            "p4 yaw; dives in place; an altitude in the water is the depth, one above it means `TKOFF_DEPTH`; position "
            "unused"
        ),
    ),
    ItemType(
        command=Command.NAV_DELAY,
        parse=nav_items.wait,
        uses="p1 [s] without pauses; a time of day is refused",
    ),
    ItemType(
        command=Command.CONDITION_DELAY,
        parse=nav_items.wait,
        uses="as 93, without a MISSION_ITEM_REACHED",
    ),
    ItemType(
        command=Command.CONDITION_DISTANCE,
        parse=do_items.near,
        uses="p1 [m]: the following DO_ items wait until the next place is so near",
    ),
    ItemType(
        command=Command.CONDITION_YAW,
        parse=do_items.set_heading,
        uses=(
            "p1 heading [deg], p3 -1 = to port, p4 1 = relative; for later goals without a heading, at once for a "
            "delay that follows"
        ),
    ),
    ItemType(
        command=Command.CONDITION_GATE,
        parse=do_items.gate,
        uses=("as 114, until the plane through this place across the path is passed; p1 0, p2 1 = its altitude counts"),
        placed=True,
    ),
    ItemType(
        command=Command.DO_JUMP,
        parse=do_items.jump,
        uses="p1 item, p2 repeats (-1 = for ever)",
    ),
    ItemType(
        command=Command.DO_CHANGE_SPEED,
        parse=do_items.change_speed,
        uses="p1 0 or 1, p2 speed over ground [m/s], at most `SPD_PLANAR_MAX`; -2 = `SPD_CRUISE` again",
    ),
    ItemType(
        command=Command.DO_SET_HOME,
        parse=do_items.set_home,
        uses="p1 1 = here",
    ),
    ItemType(
        command=Command.DO_SET_ROI_LOCATION,
        parse=do_items.look_at,
        uses=("heading to this place from here on (altitude unused); headings of waypoints do not count"),
        placed=True,
    ),
    ItemType(
        command=Command.DO_SET_ROI_NONE,
        parse=do_items.look_at,
        uses="ends that",
    ),
    ItemType(
        command=Command.DO_SET_ROI,
        parse=do_items.look_at,
        uses="p1 3 or 0; as 195; position 0, 0 = as 197",
        placed=True,
    ),
    ItemType(
        command=Command.DO_FENCE_ENABLE,
        parse=do_items.fence_on,
        uses="p1 1; 0 and 2 are refused: a mission cannot switch the fence off",
    ),
    ItemType(
        command=Command.IMAGE_START_CAPTURE,
        parse=payload_items.start_capture,
        uses="p2 interval [s], at least 0.2; p3 count (0 = until stopped)",
    ),
    ItemType(
        command=Command.IMAGE_STOP_CAPTURE, parse=payload_items.stop_capture, uses="ends stills by time and by distance"
    ),
    ItemType(
        command=Command.DO_SET_CAM_TRIGG_DIST,
        parse=payload_items.trigger_by_way,
        uses="p1 distance between stills [m], 0 = stop; p3 1 = the first at once",
    ),
    ItemType(
        command=Command.DO_SET_CAM_TRIGG_INTERVAL,
        parse=payload_items.trigger_by_time,
        uses="p1 time between stills [ms], 0 = stop",
    ),
    ItemType(command=Command.DO_DIGICAM_CONTROL, parse=payload_items.digicam_control, uses="p5 above 0: one still"),
    ItemType(command=Command.SET_CAMERA_MODE, parse=payload_items.camera_mode, uses="p2 0 or 2 (stills)"),
    ItemType(command=Command.DO_SET_SERVO, parse=payload_items.set_servo, uses="p1 output, p2 pulse [us]"),
    ItemType(
        command=Command.DO_REPEAT_SERVO,
        parse=payload_items.repeat_servo,
        uses="p1 output, p2 pulse [us], p3 cycles, p4 cycle time [s]",
    ),
    ItemType(
        command=Command.DO_SET_RELAY,
        parse=payload_items.set_relay,
        uses="p1 relay from 0, p2 1 = on, 0 = off, -1 = toggle",
    ),
    ItemType(
        command=Command.DO_REPEAT_RELAY,
        parse=payload_items.repeat_relay,
        uses="p1 relay, p2 cycles, p3 cycle time [s]",
    ),
    ItemType(
        command=Command.DO_GRIPPER,
        parse=payload_items.gripper,
        uses="p1 gripper from 1 (0 = the first), p2 0 = open, 1 = close",
    ),
    ItemType(
        command=Command.DO_SET_ACTUATOR,
        parse=payload_items.set_actuator,
        uses="p1 to p4 actuators 1 to 4, -1 to 1, NaN = unchanged; z 1 = actuators 7 to 10",
    ),
    *(
        ItemType(command=command, parse=payload_items.refused(why), uses=f"refused: {why}")
        for command, why in (
            (Command.VIDEO_START_CAPTURE, "the camera takes stills only"),
            (Command.VIDEO_STOP_CAPTURE, "the camera takes stills only"),
            (Command.SET_CAMERA_ZOOM, "the camera has no zoom"),
            (Command.SET_CAMERA_FOCUS, "the camera has no focus"),
            (Command.DO_DIGICAM_CONFIGURE, "the camera has nothing to configure"),
            (Command.DO_MOUNT_CONFIGURE, "the camera is fixed"),
            (Command.DO_MOUNT_CONTROL, "the camera is fixed"),
            (Command.DO_GIMBAL_MANAGER_PITCHYAW, "the camera is fixed"),
        )
    ),
)

ITEM_TYPES: dict[int, ItemType] = {int(row.command): row for row in _ROWS}
"""By MAV_CMD, in the order of the documentation."""


def parse_step(item: PlanItem, origin: Origin) -> Step:
    """The step that a mission item asks for; ItemRefusedError if it cannot be flown."""
    if item.is_home:
        return Agreed(seq=item.seq)
    found = ITEM_TYPES.get(item.command)
    if found is None:
        known = ", ".join(str(number) for number in ITEM_TYPES)
        text = f"command {item.command} is not supported in a mission; use one of {known}"
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
