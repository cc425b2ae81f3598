"""Every text of ours to operators (STATUSTEXT and the log's events), one row each.

A row has a severity, a template with named fields, a meaning and a remedy. The sender calls the row with its fields:
``ARMED()``, ``MODE(name="HOLD")``. docs/messages.md is written from this table (docs/messages_page.py). The
conditions of failsafes have a table of their own, :mod:`autopilot.command.failsafe_table`.
"""

import string
from dataclasses import dataclass
from typing import NamedTuple

from autopilot.core.messages import FALLBACK_TEXT, Event, Severity
from autopilot.core.phrases import ARMING_CHECK, NO_FENCE, NO_START


class OperatorText(NamedTuple):
    """A row with its fields filled in."""

    severity: Severity
    text: str

    def event(self, t_us: int) -> Event:
        """As an event of a time."""
        return Event(t_us=t_us, severity=self.severity, text=self.text)


@dataclass(frozen=True, slots=True)
class Row:
    """One message."""

    severity: Severity
    template: str
    meaning: str
    remedy: str = ""
    """"" = nothing to do."""

    @property
    def fields(self) -> tuple[str, ...]:
        """Names in the template."""
        return tuple(name for _, name, _, _ in string.Formatter().parse(self.template) if name is not None)

    def __call__(self, **fields: object) -> OperatorText:
        """The message now."""
        return OperatorText(self.severity, self.template.format(**fields))

    def event(self, t_us: int, /, **fields: object) -> Event:
        """The message as an event of a time."""
        return self(**fields).event(t_us)


def _debug(template: str, meaning: str, remedy: str = "") -> Row:
    return Row(Severity.DEBUG, template, meaning, remedy)


def _info(template: str, meaning: str, remedy: str = "") -> Row:
    return Row(Severity.INFO, template, meaning, remedy)


def _notice(template: str, meaning: str, remedy: str = "") -> Row:
    return Row(Severity.NOTICE, template, meaning, remedy)


def _warning(template: str, meaning: str, remedy: str = "") -> Row:
    return Row(Severity.WARNING, template, meaning, remedy)


def _error(template: str, meaning: str, remedy: str = "") -> Row:
    return Row(Severity.ERROR, template, meaning, remedy)


def _critical(template: str, meaning: str, remedy: str = "") -> Row:
    return Row(Severity.CRITICAL, template, meaning, remedy)


# Arming, modes and the end of a run

ARMED = _info("Armed", "Thrusters may turn.")
ARMED_UNFENCED = _notice(
    f"Armed with {NO_FENCE}: keep clear of walls, or upload one",
    "Only the depth band bounds the vehicle's motion.",
    "Upload a fence, or set FENCE_REQUIRED 1 to make one a condition for arming.",
)
FORCED_ARMING = _warning(
    "Forced arming despite: {reasons}", "Arming checks failed and were overridden.", "Disarm and fix what is named."
)
DISARMED = _info("Disarmed", "Thrusters are neutral.")
EMERGENCY_STOP = _warning("Emergency stop", "Disarmed by force, by the operator, a failsafe or a fault.")
DISARM_CONFIRMED = _notice("Flight controller is disarmed now", "Its heartbeat shows it, later than usual.")
DISARM_NOT_CONFIRMED = _critical(
    "Flight controller does not confirm disarming: use its own switch",
    "3 s and twelve requests after disarming its heartbeat is still armed. Requests go on.",
    "Disarm it at its own switch or cut the thrusters' power; check the serial or network link.",
)
MODE = _info("Mode {name}", "The operator has changed the mode.")
RESTARTING = _info("Restarting", "The service restarts as asked.")
STOPPING = _info("Stopping", "The service ends as asked.")
SERVICE_ENDS = _warning("Service ends: asked for by {client}", "A client sent PREFLIGHT_REBOOT_SHUTDOWN 2.")
SERVICE_RESTARTS = _info("Service restarts: asked for by {client}", "A client sent PREFLIGHT_REBOOT_SHUTDOWN 1.")

# Flight controller and its pilot

STOPPED_BELOW = _critical(
    "Flight controller disarmed: {reason}",
    "The flight controller no longer drives the thrusters for the autopilot, which has disarmed.",
    "Look at the flight controller's own messages, then arm again.",
)
PILOT_HAS_CONTROL = _warning(
    "Pilot has control ({mode}): autopilot waits",
    "A pilot steers through the flight controller. The autopilot sends nothing until its mode is given back.",
)
PILOT_GAVE_BACK = _info("Pilot returned control: {next}", "The autopilot steers again. PILOT_BACK 1 resumes a mission.")

# Failsafes; their conditions with the remedy of each are in docs/failsafes.md

FAILSAFE_ACTS = _critical(
    "Failsafe: {condition}", "A failsafe that acts has begun, or one that is critical.", "docs/failsafes.md."
)
FAILSAFE_WARNS = _warning("Failsafe: {condition}", "A failsafe that only warns has begun.", "docs/failsafes.md.")
FAILSAFE_OVER = _info("Failsafe over: {condition}", "The condition has ended; the mode stays.")
FAILSAFE_ENDS_FLIGHT = _critical(
    "Failsafe {verb}: {conditions}",
    "The vehicle was disarmed, or its thrusters were handed to the flight controller.",
    "docs/failsafes.md.",
)
FAILSAFE_DROPS = _critical("Failsafe drops weight: {conditions}", "The drop weight is released.", "docs/failsafes.md.")
FAILSAFE_MODE = _critical(
    "Failsafe {mode}: {conditions}",
    "The failsafe's mode replaces the chosen one until the operator chooses another.",
    "docs/failsafes.md.",
)
FAILSAFES_OVERRIDDEN = _warning(
    "Operator overrides failsafes: {names}", "FS_OVERRIDE: these warn only.", "Set FS_OVERRIDE 0 when it is over."
)
FAILSAFE_OVERRIDE_ENDED = _warning("Failsafe override ended", "FS_OVERRIDE is 0: failsafes act again.")
FAULT_DISARMED = _critical(
    "Disarmed: {part} failed twice the same way",
    "The same internal error came again while armed.",
    "Keep the log, restart the service, report the error.",
)
FAULT = _critical(
    "{line}", "An internal error, with the part that failed and where.", "Keep the log, restart the service, report it."
)

# Estimate

POSITION_GOOD = _info("Position is good again", "Fixes come and agree with the estimate.")
DEAD_RECKONING = _warning(
    "Dead reckoning: no position fix, look for markers",
    "Position is carried on by model, AHRS and velocity log; its error grows.",
    "Move to where markers are in view.",
)
POSITION_LOST = _error(
    "Position lost, drifting: bring markers into view", "There is no valid estimate.", "Steer to markers by hand."
)
POSITION_LOST_PILOTED = _critical(
    "Position lost: no fence, no limits, steer by hand",
    "A piloted mode flies without position: fence and clearances are not kept.",
    "Keep clear of walls; bring markers into view.",
)
POSITION_BACK_PILOTED = _info("Position is back: fence and limits apply", "Fence and clearances are kept again.")
ESTIMATE_NOT_FINITE = _error(
    "Estimate not finite: not used, restart if it stays",
    "The estimator returned NaN, infinity or impossible values; the last estimate is used for 0.2 s.",
    "Restart the service if it lasts; keep the log.",
)
ESTIMATE_FINITE = _info("Estimate is finite again", "The estimate is used again.")
ESTIMATOR_REMARK = _warning("{text}", "One of the following, or a remark of an estimator of your own.")
STAMPS_JUMPED = _warning(
    "{name} stamps jumped {jump_ms:+.0f} ms: check its clock", "Exposure times jumped.", "Check the clock's source."
)
STAMPS_OFF = _warning(
    "{name} stamps {off_ms:.0f} ms {what}: calibrate latency", "Images disagree with gyro in time.", "Set latency_s."
)
FOCAL_LENGTH_OFF = _warning(
    "Focal length {percent:.1f} % too {what}: recalibrate camera",
    "Laser and markers disagree.",
    "Calibrate the camera.",
)
SHEET_OFF = _warning(
    "Sheet {name} lies {off_mm:.0f} mm, {turn_deg:.1f} deg off the map", "Estimated.", "Run `autopilot markers survey`."
)
MARKERS_SWAPPED = _warning(
    "Markers {number} and {other} are swapped in the map", "Each is seen at the other's place.", "Correct the map."
)
MARKER_TAKES_PLACE = _warning("Marker {number} lies where the map has {other}", "Wrong number.", "Correct the map.")
MARKER_UNKNOWN = _warning("Marker {number} lies where the map has none", "It is not in the map.", "Add or remove it.")
MARKER_OFF = _warning(
    "Marker {number} lies {off_cm:.1f} cm {way} of its map place", "It was moved.", "Correct the map or the marker."
)
ACCELEROMETER_WRONG = _warning(
    "Accelerometer wrong: keep markers in view", "Accelerations contradict fixes or depth.", "Check the AHRS' range."
)
GYRO_WRONG = _warning(
    "Gyro wrong: keep markers in view, check AHRS", "Rates contradict fixes or attitude.", "Check the AHRS, restart it."
)
FIXES_DISAGREE = _warning(
    "Markers disagree with dead reckoning: check map",
    "Marker positions disagree with dead reckoning.",
    "Check that markers hang where the map says, and the camera calibration.",
)
RANGE_DISAGREES = _warning(
    "Laser and marker height disagree: calibrate camera",
    "Laser range and the height from markers disagree.",
    "Calibrate the camera; check the laser's mounting.",
)
MAP_DISAGREES = _warning(
    "Marker map disagrees: check it or survey it", "Markers contradict each other.", "Run `autopilot markers survey`."
)
CALIBRATION_SUSPECT = _warning(
    "Camera calibration suspect: see messages", "Pictures fit another calibration better.", "Calibrate the camera."
)
REPEATED_RESETS = _warning(
    "Position reset repeatedly: check map, camera", "The estimate jumped to fixes several times.", "Check map, camera."
)
CAMERA_WRONG = _warning(
    "Camera wrong: it shows another place or time", "Pictures do not follow gyro and model.", "Check the video source."
)

# Thrusters and commands

LATENCY_NORMAL = _info("Command latency is back to normal", "The estimated command latency is 0 again.")
LATENCY = _warning(
    "Command latency {delay_s:.1f} s: check the tether",
    "Estimated latency from command to motion.",
    "Check tether, network and the flight controller's load.",
)
TWIN_LOSS = _warning(
    "One of {names} gives {percent:.0f} % of its thrust",
    "Redundant thrusters: the data do not say which of them is weak.",
    "Inspect all of them; test each with a motor test.",
)
TWINS_RESTORED = _info("{names} give their full thrust again", "No loss is estimated any more.")
THRUSTER_LOSS = _warning(
    "Thruster {name} gives {percent:.0f} % of its thrust",
    "Estimated effectiveness; the allocation accounts for it.",
    "Clear its propeller. A damaged thruster: set THRn_HEALTH.",
)
THRUSTER_RESTORED = _info("Thruster {name} gives its full thrust again", "No loss is estimated any more.")
THRUSTERS_UNJUDGED = _info(
    "Thrust not estimated, used too little: {names}",
    "These thrusters turned too little in this flight to estimate a loss.",
)
NO_FREE_PATH = _warning(
    "No free path to the goal: holding; move the goal",
    "Fence and obstacles leave no path to the goal.",
    "Move the goal, the fence or the obstacle.",
)
FENCE_TOO_NEAR = _warning(
    "New fence: {lack_m:.2f} m too near, moving out", "The vehicle is too close to a new fence and moves away from it."
)
FENCE_GAP = _warning("{text}", "A gap in the fence or between obstacles that FENCE_GAP_CHK 1 only warns of.")
MOTOR_TEST = _info("Motor test: {number} {name}{limit}", "This thruster turns.", "Keep hands off.")
MOTOR_TEST_OVER = _info("Motor test over", "Thrusters stand.")
MOTOR_TEST_ENDED = _info("Motor test over: {reason}", "Thrusters stand: the test was ended.")

# Sensors and devices

DEVICE_FAILED = _critical(
    "{device} failed: {reason}", "A driver returned an error.", "Check its cable, power and port; repeated every 5 s."
)
DEVICE_WORKS = _info("{device}: working again", "It has worked for 1 s.")
BATTERY_IMPLAUSIBLE = _warning(
    "Battery readings implausible: check the monitor",
    "A reading is not finite or negative; it is not used.",
    "Check monitor.",
)
BATTERY_VOLTAGE_IMPLAUSIBLE = _warning(
    "Battery voltage {voltage_v:.1f} V, plausible {low_v:.3g} to {high_v:.3g} V: check monitor, vehicle file",
    "No voltage of the battery in the vehicle file; the reading is not used.",
    "Correct the monitor's scale or the vehicle file's battery.",
)
CAMERA_DARK = _warning("Camera black: remove its cover, switch on light", "Pictures are black.")
CAMERA_BRIGHT = _warning("Camera over-exposed: shorten exposure, dim light", "Pictures are clipped at white.")
CAMERA_FLAT = _warning("Camera shows one grey level: check lens, cable", "Pictures have no contrast at all.")
CAMERA_TORN = _warning("Camera pictures are torn: check its cable", "Parts of pictures are of different frames.")
CAMERA_FROZEN = _warning("Camera frozen, same picture again: restart it", "Every picture is the same.")
CAMERA_WRONG_SIZE = _warning("Picture size is not the vehicle file's: check it", "The calibration does not apply.")
CAMERA_WRONG_TYPE = _warning("Camera sends no 8-bit pictures: set its format", "Pictures cannot be used.")
CAMERA_FOGGY = _warning("Camera foggy: clean its lens, or water is turbid", "Contrast is too low for markers.")
CAMERA_SILENT = _warning("Camera sends no pictures: check its cable", "Pictures have come and come no more.")
CAMERA_WORKS = _info("Camera works again", "Pictures are usable again.")
PHOTOS_STOPPED = _warning("Photos stopped: {reason}", "The camera cannot take stills any more.", "Fix what is named.")
PHOTOS_SKIPPED = _warning(
    "Photos skipped: camera too slow, ask less often",
    "Stills are asked for faster than the camera takes them.",
    "Choose a longer interval or distance.",
)
PHOTO_FAILED = _warning("Photo {index} failed: {reason}", "This still is lost.", "Fix what is named.")
FLOOR_LOST = _warning("No range to the floor: holding depth", "SURFTRAK has no altimeter reading.", "Check altimeter.")
FLOOR_BACK = _info("Range to the floor is back: holding height", "SURFTRAK follows the floor again.")
IN_OBSTACLE = _warning(
    "Obstacle of {size_m:.0f} m ignored: it covers the vehicle",
    "A reported obstacle covers the vehicle; it is ignored.",
    "Correct what reports the obstacle.",
)

# Missions

MISSION_COMPLETE = _info("Mission complete, laps: {laps}{skipped}", "All items are done.")
MISSION_CHANGED = _warning(
    "Mission changed while it ran: holding, start again", "Another mission was uploaded.", "Start the mission."
)
REACHED = _info("Reached item {seq}", "A mission item is done.")
REACHED_SEVERAL = _info("Reached items {seqs}", "Several mission items are done.")
REACHED_MANY = _info("Reached {count} items, the last is {seq}", "Many mission items are done.")
OUT_OF_REACH = _warning("{name} out of reach: {reason}", "No progress for WP_STUCK_TIME; WP_STUCK_ACT only warns.")
ITEM_SKIPPED = _warning("Skipped item {seq}, out of reach: {reason}", "No progress for WP_STUCK_TIME: next item.")
ITEM_HELD = _warning(
    "Holding: item {seq} out of reach, {reason}", "No progress for WP_STUCK_TIME.", "Move the item or wait for slack."
)
UPSTREAM = _warning(
    "{leg}", "The current leaves little or no speed over ground on a leg.", "Raise the speed, move or reverse the leg."
)
HOME_KEPT = _warning("Home unchanged: {reason}", "Home could not be set where the vehicle was armed.")
PLAN_HOLD = _warning("Holding: {problem}", "A change made the running plan invalid.", "Correct the plan, start again.")
PLAN_NO_START = _warning(NO_START + "{problem}", "The stored plan must not be flown.", "Correct the plan.")
PLAN_OK = _info("Plan ok", "What kept the plan from starting is gone.")
ITEM_ORDER_FAILED = _warning("Item {seq}: {reason}", "A mission item's order was refused; the mission goes on.")
SURFACED = _info("Surfaced", "Mode SURFACE is done: disarmed.")
DIVED = _info("Dived to {depth_m:.2f} m: holding", "Mode DIVE is done.")
CIRCLE_DONE = _info("Circle done: holding", "Mode CIRCLE has made its turns.")
SETPOINTS_STOPPED = _warning(
    "Set points stopped: holding", "No set point for the timeout of GUIDED.", "Check the client that sends them."
)

# MAVLink: links, keys and control

GREETING = _info("{name} {version}, {note}", "Name and version, to each client 2 s after its first message.")
GREETING_REFUSAL = _warning("No arming: {reason}", "A reason against arming that a client cannot see.", "As it says.")
KEY_UNKNOWN = _warning(
    "Frames with an unknown key rejected: check the key", "MAVLink signing.", "Give the client the key."
)
UNSIGNED = _warning("Unsigned frames rejected: sign them", "MAVLink signing is on.", "Give the client the key.")
SIGNED_TOO_OLD = _warning(
    "Signed frames rejected, too old: check the clock", "Time stamps are behind.", "Set the clock."
)
FRAMES_REFUSED = _warning("frames rejected so far: {counts}", "For the log: counts by reason.")
FLOODED = _warning(
    "{sender} floods its link: throttled", "A client sends more than is processed.", "Lower its message rates."
)
FLOODED_BYTES = _warning("{sender} on link {link}: {lost} bytes dropped, {total} in all", "For the log.")
HIGH_LATENCY = _info("link {link}: high latency", "For the log: HIGH_LATENCY2 only on this link.")
HIGH_LATENCY_OVER = _info("link {link}: high latency is over", "For the log: all messages again.")
SIGNING_NOT_SAVED = _warning("Signing key or time not saved: {problem}", "A restart loses it.", "Check the disk.")
KEY_FROM_NETWORK = _warning("Key refused: use `autopilot mavlink key` on board", "Keys do not come over a network.")
KEY_WHILE_ARMED = _warning("Key refused: disarm first", "Keys do not change while armed.", "Disarm.")
KEY_UNSIGNED = _warning("Key refused: sign it with the present key", "A key in force must sign its successor.")
KEY_ZERO = _warning("Key refused: it is all zero", "An all-zero key is none.", "Choose another key.")
SIGNING_ON = _warning("Signing on: only signed frames are accepted (key set by {client})", "A signing key was set.")
SIGNING_OFF = _warning("Signing off (key set by {client})", "The signing key was removed.")
OPERATOR_SILENT = _warning("Operator {system} silent: nobody in control", "FS_GCS_TIMEOUT.", "Take control.")
OPERATOR_RELEASED = _info("Operator {system} released control", "Every client may command.")
OPERATOR_IN_CONTROL = _info("Operator {system} is in control", "Others may only watch.")
OPERATOR_ASKS = _info("Operator {system} asks for control", "Another ground station wants control.", "Release it.")
REFUSED = _warning(
    "{reason}", "A command, set point, parameter or message was refused, with the reason.", "As it says."
)

# MAVLink: plans, parameters, logs, sticks

PLAN_ACCEPTED = _info("{kind} plan accepted: {count} items{home}", "It is in force and on disk.")
PLAN_REFUSED = _warning("{kind} refused: {reason}", "The plan in force stays.", "Correct the item and upload again.")
PLAN_DENIED = _warning(
    "{kind} change denied: client {client} is uploading, try again later", "One upload at a time.", "Try again."
)
PLAN_NOT_ON_DISK = _warning("Plan in force, not on disk yet", "The disk is slow; a restart may lose it.", "Check disk.")
PLAN_CLEARED = _info("cleared: {names}", "For the log.")
PLAN_NOT_CLEARED = _warning("Not cleared ({names}): {reason}", "The plan in force stays.", "As it says.")
UPLOAD_CANCELLED = _info("{kind} upload cancelled by the client", "For the log.")
MISSION_UNFENCED = _warning(
    f"Mission with {NO_FENCE}: upload its fence, or keep clear of walls", "Only the depth band bounds the vehicle."
)
PARAMETER_SET = _info("parameter {name} = {value:g} (was {before:g})", "For the log.")
PARAMETER_STUB = _warning("{name} has no effect here and is unchanged", "Known to ground stations, not to us.")
PARAMETER_TYPE = _warning("parameter {name} is {type}: other types are refused", "Wrong type.", "Send it as that type.")
PARAMETERS_RESET = _warning("Parameters set to defaults by {client}: {count}", "That many parameters changed.")
PARAMETERS_SAVED = _info("Parameters are saved now", "What could not be saved is saved.")
PARAMETERS_NOT_SAVED = _warning("Not saved ({failure}), lost at restart: {names}", "In force only.", "Check the disk.")
PARAMETER_NOT_ON_DISK = _warning("{name} in force, not on disk yet", "The disk is slow.", "Check the disk.")
LOGS_ERASING = _warning("All logs are being erased: asked for by {client}", "LOG_ERASE.")
LOGS_ERASED = _info("Logs erased: {count}", "LOG_ERASE is done.")
LOGS_ARMED = _warning("Logs not erased: disarm first", "Not while armed.", "Disarm.")
LOGS_NO_FOLDER = _warning("Logs not erased: there is no log folder", "The service runs without logs.")
LOGS_NOT_ERASED = _warning("Logs not erased: {error}", "The disk refused.", "As it says.")
LOG_MISSING = _warning("There is no log {number}: list the logs again", "Logs have changed.", "List the logs again.")
LOG_UNREADABLE = _warning("Log {number} cannot be read: list the logs again", "The disk refused.", "List them again.")
STICKS_UNUSED = _info("Pitch and roll sticks have no effect here", "MANUAL_CONTROL: x, y, z and r are used.")
STICKS_OF_ANOTHER = _warning("Sticks ignored: {client} steers", "One client steers at a time.", "Let that one stop.")
STICK_BELOW_ZERO = _notice("Vertical stick below 0: interpreted as PILOT_Z 1", "Its range is -1000 to 1000.")
STICK_NOT_CENTRED = _warning(
    "Vertical stick not used until it rests at {neutral}: see PILOT_Z", "It is not at neutral.", "Centre the stick."
)
PILOT_GAIN = _info("Pilot gain {percent:.0f} %", "Factor on all sticks.")
BUTTON_UNKNOWN = _warning(
    "Button {button}: function {function} is not offered, see BTNn_FUNCTION", "Nothing is done.", "Set BTNn_FUNCTION."
)
ARMING_REASON = _warning(ARMING_CHECK + "{reason}", "Answer to RUN_PREARM_CHECKS, one per reason.", "As it says.")
ARMING_UNFENCED = _notice(f"{ARMING_CHECK}{NO_FENCE}, which FENCE_REQUIRED allows", "Answer to RUN_PREARM_CHECKS.")
ARMING_PASSED = _info("Arming checks passed", "Answer to RUN_PREARM_CHECKS.")
ODOMETRY_FRAME = _warning(
    "ODOMETRY in frame {frame} is not used: send MAV_FRAME_LOCAL_NED (1) or LOCAL_FRD (20)",
    "The pose cannot be used.",
    "Send another frame.",
)

# Controller

SOLVER = _debug("Solver: {name}", "For the log.")
SLOWER_SOLVER = _warning(
    "Slower solver ({name}): see log, reinstall", "The compiled solver is missing.", "Install the package again."
)
FALLBACK_SHIFTED_PLAN = _warning(
    FALLBACK_TEXT + ", last plan goes on", "The optimiser found no solution; the rest of its last plan is flown."
)
FALLBACK_HOLDING = _warning(
    FALLBACK_TEXT + ", holding position", "The optimiser finds no solution; a simpler controller holds position."
)
FALLBACK_OVER = _info("Controller has solutions again", "The optimiser commands the thrusters again.")
CONTROL_NOT_FINITE = _error(
    "Estimate not finite: thrusters neutral, recover it",
    "The controller was given NaN or infinity.",
    "Recover the vehicle, keep the log.",
)
CONTROL_FINITE = _info("Estimate finite again after {count} ticks without thrust", "Thrusters are commanded again.")
LIMITS_GIVEN_UP = _warning(
    "No plan keeps all limits: give room or take over",
    "A soft limit is violated for a second: pushed out of the fence, or an obstacle too near.",
    "Move the fence, obstacle or goal, or steer by hand.",
)
CERTIFICATE = _debug("{name}: {text}", "For the log: what the controller guarantees at this goal.")
NO_CERTIFICATE = _debug("{name}: no certificate: {error}", "For the log.")
LIPSCHITZ = _debug("{text}", "For the log: bound on the prediction error of the model.")
GOAL_BEYOND_LIMIT = _warning("{name}: beyond the {limit} limit, move it", "The goal violates a limit.", "Move it.")
GOAL_LACKS_THRUST = _warning(
    "{name}: too little {limit} to stay there", "Thrusters cannot hold the vehicle at this goal.", "Move the goal."
)
GOAL_LACKS_YAW_RATE = _warning(
    "{name}: SPD_YAW_MAX leaves nothing to stay with", "No yaw rate is left to hold heading.", "Raise SPD_YAW_MAX."
)
GOAL_IN_CURRENT = _warning(
    "{name}: current {current_m_s:.2f} m/s, too fast to stay", "The current exceeds the vehicle's speed.", "Move it."
)
BUOYANCY_BEYOND_THRUST = _warning(
    "Too {trim} for its thrusters: trim the vehicle", "Estimated buoyancy exceeds vertical thrust.", "Change ballast."
)
BUOYANCY_OFF = _warning(
    "{way} than its file by {force_n:.1f} N: trim it", "Estimated buoyancy.", "Change ballast or the vehicle file."
)
WORK_FAILED = _debug("{work}: {kind}: {error}", "For the log: an exception in background work.")
NO_ENERGY_PLAN = _warning(
    "No energy plan: flying the plain route", "The minimum-energy planner failed.", "See the log."
)
ROUTE_SEARCH_FAILED = _warning(
    "Route search failed: holding, send another goal", "The search ended with an exception.", "Send another goal."
)

# Service, links and drivers

START_WARNING = _warning("{text}", "A warning from the start of the service.", "As it says.")
PLANS_NOT_SAVED = _warning("Plans not saved: {cause}", "A restart loses the present plans.", "Check the disk.")
LOG_STOPPED = _warning("Log stopped: {cause}", "Nothing is recorded until the next arming.", "Check the disk.")
LOG_DISK_SLOW = _warning("Log loses messages: disk too slow", "Messages are dropped.", "Use a faster disk.")
LOG_INCOMPLETE = _warning("Log misses messages: internal fault", "An exception while packing.", "Report it.")
STATE_NOT_KEPT = _warning("No arming: {text}", "Stored plans or parameters are lost or differ.", "Check and accept it.")
STATE_ACCEPTED = _warning("Accepted by the operator: {text}", "It no longer prevents arming.")
LINK_PROBLEM = _warning("{name}: {problem}", "A MAVLink link has failed.", "Check cable and port.")
LINK_WARNING = _warning("{text}", "A link's port or clients: refused or dropped.", "As it says.")
LINK_NEWS = _info("{text}", "A link's port or clients have changed.")
LINK_BACK = _info("{name}: back", "The link works again.")
VIEW = _info("View: {text}", "A simulation was changed from the live view.")
FOUND_ARMED = _critical(
    "Flight controller found ARMED: disarm it first", "It was armed before the service started.", "Disarm it."
)
PAYLOAD_REFUSED = _warning("{text}", "The flight controller refused a servo or relay.", "As it says.")
DEVICE_CONNECTED = _notice("{name}: connected", "A device that was missing is open.")
DEVICE_RECONNECTED = _notice("{name}: reconnected", "A device that was lost is open again.")
DEVICE_DOWN = _warning(
    "{name}: down: {problem}", "A device cannot be used; it is opened again and again.", "As it says."
)
DEVICE_SILENT = _warning("{name}: silent: check power and settings", "Open, but nothing arrives.", "Check its power.")
DEVICE_HEARD = _notice("{name}: working again", "Data arrive again.")
CLOCK_JUMPED = _warning(
    "{what}{used}: check power, time sync", "A sensor's time stamps jumped.", "Check its power and time sync."
)

ROWS: dict[str, Row] = {name: row for name, row in tuple(globals().items()) if isinstance(row, Row)}
"""Identifier -> row, in the order of this file."""
