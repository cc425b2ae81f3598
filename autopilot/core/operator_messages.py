"""All texts to operators (STATUSTEXT and the log's events), one row each.

A row has a severity, a template with named fields, a meaning and a remedy. The sender calls the row with its fields:
``ARMED()``, ``MODE(name="HOLD")``. docs/messages.md is generated from this table (docs/messages_page.py). The
conditions of failsafes have a table of their own, :mod:`autopilot.command.failsafe_table`.
"""

import string
from dataclasses import dataclass
from functools import partial
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
    severity: Severity
    template: str
    meaning: str = ""
    """Beyond the text; "" = nothing."""
    remedy: str = ""
    """Beyond the text; "" = nothing."""

    @property
    def fields(self) -> tuple[str, ...]:
        return tuple(name for _, name, _, _ in string.Formatter().parse(self.template) if name is not None)

    def __call__(self, **fields: object) -> OperatorText:
        return OperatorText(self.severity, self.template.format(**fields))

    def event(self, t_us: int, /, **fields: object) -> Event:
        """The message as an event of a time."""
        return self(**fields).event(t_us)


_debug = partial(Row, Severity.DEBUG)
_info = partial(Row, Severity.INFO)
_notice = partial(Row, Severity.NOTICE)
_warning = partial(Row, Severity.WARNING)
_error = partial(Row, Severity.ERROR)
_critical = partial(Row, Severity.CRITICAL)

# Arming, modes and the end of a run

ARMED = _info("Armed")
ARMED_UNFENCED = _notice(
    f"Armed with {NO_FENCE}: keep clear of walls, or upload one",
    "Only the depth band limits the motion. FENCE_REQUIRED 1 makes a fence a condition for arming.",
)
FORCED_ARMING = _warning("Forced arming despite: {reasons}", "", "Disarm and fix what is named.")
DISARMED = _info("Disarmed")
EMERGENCY_STOP = _warning("Emergency stop", "Disarmed by force, by the operator, a failsafe or a fault.")
DISARM_CONFIRMED = _notice("Flight controller is disarmed now")
DISARM_NOT_CONFIRMED = _critical(
    "Flight controller does not confirm disarming: use its own switch",
    "Still armed 3 s after disarming; requests go on.",
    "Use its own switch or cut the thrusters' power.",
)
MODE = _info("Mode {name}")
RESTARTING = _info("Restarting")
STOPPING = _info("Stopping")
SERVICE_ENDS = _warning("Service ends: asked for by {client}", "PREFLIGHT_REBOOT_SHUTDOWN 2.")
SERVICE_RESTARTS = _info("Service restarts: asked for by {client}", "PREFLIGHT_REBOOT_SHUTDOWN 1.")

# Flight controller and its pilot

FLIGHT_CONTROLLER_DISARMED = _critical(
    "Flight controller disarmed: {reason}",
    "The autopilot has disarmed too.",
    "Read the flight controller's messages, then arm again.",
)
PILOT_HAS_CONTROL = _warning(
    "Pilot has control ({mode}): autopilot waits",
    "A pilot steers through the flight controller; the autopilot sends nothing.",
)
PILOT_GAVE_BACK = _info("Pilot returned control: {next}", "PILOT_BACK 1 resumes a mission.")

# Failsafes; their conditions with the remedy of each are in docs/failsafes.md

FAILSAFE_ACTS = _critical("Failsafe: {condition}", "A failsafe that acts, or a critical one, has begun.")
FAILSAFE_WARNS = _warning("Failsafe: {condition}", "A failsafe that only warns has begun.")
FAILSAFE_OVER = _info("Failsafe over: {condition}")
FAILSAFE_ENDS_FLIGHT = _critical(
    "Failsafe {verb}: {conditions}", "Disarmed, or thrusters handed back to the flight controller."
)
FAILSAFE_DROPS = _critical("Failsafe drops weight: {conditions}")
FAILSAFE_MODE = _critical("Failsafe {mode}: {conditions}", "This mode stays until the operator chooses another.")
FAILSAFES_OVERRIDDEN = _warning("Operator overrides failsafes: {names}", "FS_OVERRIDE: these only warn.")
FAILSAFE_OVERRIDE_ENDED = _warning("Failsafe override ended", "FS_OVERRIDE is 0.")
FAULT_DISARMED = _critical(
    "Disarmed: {part} failed twice the same way",
    "The same internal error came twice while armed.",
    "Keep the log, restart the service, report it.",
)
FAULT = _critical(
    "{line}", "An internal error: the part that failed and where.", "Keep the log, restart the service, report it."
)

# Estimate

POSITION_GOOD = _info("Position is good again")
DEAD_RECKONING = _warning(
    "Dead reckoning: no position fix, look for markers",
    "Position comes from vehicle model, AHRS and velocity log; its error grows.",
)
DEAD_RECKONING_POSES = _warning(
    "Dead reckoning: no position fix, check its source",
    "No poses from outside arrive, or all are rejected. Position comes from vehicle model, AHRS and velocity log.",
)
POSITION_LOST_POSES = _error(
    "Position lost, drifting: check its source", "The estimate is not valid.", "Steer by hand."
)
POSITION_LOST = _error(
    "Position lost, drifting: bring markers into view", "The estimate is not valid.", "Steer by hand."
)
POSITION_LOST_PILOTED = _critical(
    "Position lost: no fence, no limits, steer by hand",
    "",
    "Keep clear of walls; bring markers into view or restart the source of poses.",
)
POSITION_BACK_PILOTED = _info("Position is back: fence and limits apply")
ESTIMATE_NOT_FINITE = _error(
    "Estimate not finite: not used, restart if it stays",
    "NaN, infinity or impossible values; the last estimate counts for 0.2 s.",
    "Keep the log.",
)
ESTIMATE_FINITE = _info("Estimate is finite again")
ESTIMATOR_REMARK = _warning("{text}", "From an estimator of your own.")
AHRS_ATTITUDE_FROZEN = _warning(
    "AHRS attitude frozen: its gyros are used, check it",
    "Its heading stays the same to the last digit while its own gyro turns.",
    "Surface and restart the AHRS.",
)
AHRS_ATTITUDE_BACK = _info("AHRS attitude works again")
FIXES_TOO_RARE = _warning(
    "Fixes {every_s:.1f} s apart: one a second is needed",
    "The position does not start with them.",
    "Raise the rate of their source, or use a velocity log and a surface fix.",
)
STAMPS_JUMPED = _warning("{name} stamps jumped {jump_ms:+.0f} ms: check its clock")
STAMPS_JUMPED_BACK = _warning(
    "{name} stamps jumped {jump_ms:+.0f} ms: check clock, AHRS",
    "Or the AHRS comes later than before: a delay on its line looks the same.",
)
STAMPS_LATE = _warning(
    "{name} stamps {late_ms:.0f} ms late: calibrate latency", "Images disagree with the gyro in time."
)
STAMPS_EARLY = _warning(
    "{name} stamps {early_ms:.0f} ms early, or AHRS late: check",
    "Either looks the same.",
    "Check the AHRS's line for a delay, then calibrate the latency.",
)
AHRS_LATE = _warning(
    "AHRS stamps {late_ms:.0f} ms late: set ahrs.time_offset_s",
    "Fixes would be of the future otherwise; corrected in flight.",
    "Check its line for a delay; enter a constant one as negative `time_offset_s`.",
)
FOCAL_LENGTH_OFF = _warning(
    "Focal length {percent:.1f} % too {what}: recalibrate camera", "The markers' images fit another lens better."
)
LENS_OFF = _warning(
    "Focal length or distortion {percent:.1f} % off: calibrate camera", "The markers' images fit another lens better."
)
CAMERA_TILTED = _warning(
    "Camera and AHRS tilt differ {off_deg:.1f} deg: check both",
    "More than their uncertainties explain.",
    "Correct the mounting of the one that is off.",
)
ORIGIN_BY_GPS = _info("Origin set by GPS: {lat_deg:.6f}, {lon_deg:.6f}")
GPS_FAR = _warning("GPS not used: {reason}")
GPS_ORIGIN_DENIED = _warning("GPS sets no origin: {reason}")
CAMERA_AWAY = _warning(
    "Camera at {now_deg:.0f} deg, markers need {wanted_deg:.0f}: tilt it",
    "Away from `camera_deg` pictures are not used.",
)
CAMERA_TILT_UNKNOWN = _warning(
    "Camera tilt unknown, no markers: see output {channel}",
    "Its pulse is not reported.",
    "Check SERVOn_FUNCTION (7) and `channel`.",
)
CAMERA_TILTED_BACK = _info("Camera is tilted back: markers are used again")
SHEET_OFF = _warning(
    "Sheet {name} lies {off_mm:.0f} mm, {turn_deg:.1f} deg off the map", "", "Run `autopilot markers survey`."
)
MARKERS_SWAPPED = _warning("Markers {number} and {other} are swapped in the map", "", "Correct the map.")
MARKER_TAKES_PLACE = _warning("Marker {number} lies where the map has {other}", "", "Correct the map or the marker.")
MARKER_UNKNOWN = _warning("Marker {number} lies where the map has none", "", "Add it to the map or remove it.")
MARKER_OFF = _warning(
    "Marker {number} lies {off_cm:.1f} cm {way} of its map place", "", "Correct the map or the marker."
)
MARKER_TURNED = _warning(
    "Marker {number} is turned by {turn_deg} deg against the map", "", "Turn it or correct the map."
)
MARKERS_NOWHERE = _warning(
    "Markers in view do not fit the map: check size_m",
    "Several of its ids in each of 90 pictures, and no pose from which they look like that.",
    "Measure a black square and the distance of two markers; check that it is the map of this floor.",
)
PRINT_OFF = _warning(
    "Markers are printed {percent:.1f} % {what} than in the map", "", "Measure a black square, correct size_m."
)
ACCELEROMETER_WRONG = _warning(
    "Accelerometer wrong: keep markers in view", "It contradicts fixes or depth.", "Check the AHRS's range."
)
GYRO_WRONG = _warning(
    "Gyro wrong: keep markers in view, check AHRS", "It contradicts fixes or attitude.", "Restart the AHRS."
)
FIXES_DISAGREE = _warning("Markers disagree with dead reckoning: check map", "", "Check the camera's calibration too.")
RANGE_DISAGREES = _warning("Laser and marker height disagree: calibrate camera", "", "Check the laser's mounting too.")
VELOCITY_LOG_DISAGREES = _warning(
    "Velocity log disagrees with fixes: check mounting",
    "Twelve in a row rejected while fixes were used; without fixes it is not used.",
    "Check its angle, lock and time stamps.",
)
VELOCITY_LOG_AGREES = _info("Velocity log agrees with fixes again")
DEPTH_DISAGREES = _warning(
    "Depth sensor disagrees with fixes: check its zero",
    "Off by more than 0.2 m, noisier than it states, or under waves.",
    "Zero it at the surface or correct `surface_pa`.",
)
MAP_DISAGREES = _warning(
    "Marker map disagrees: check it or survey it", "Markers contradict each other.", "Run `autopilot markers survey`."
)
CALIBRATION_SUSPECT = _warning("Camera calibration suspect: see messages", "Pictures fit another calibration better.")
REPEATED_RESETS = _warning(
    "Position reset repeatedly: check map, camera", "The estimate jumped to the fixes several times."
)
ACCELEROMETER_WRONG_POSES = _warning(
    "Accelerometer wrong: keep position fixes", "It contradicts fixes or depth.", "Check the AHRS's range."
)
GYRO_WRONG_POSES = _warning(
    "Gyro wrong: check AHRS, keep position fixes", "It contradicts fixes or attitude.", "Restart the AHRS."
)
POSES_DISAGREE = _warning("Poses disagree with dead reckoning: check source")
POSE_RANGE_DISAGREES = _warning("Laser and pose height disagree: check both")
POSE_LATENCY_SUSPECT = _warning("Pose latency suspect: see messages")
REPEATED_RESETS_POSES = _warning("Position reset repeatedly: check its source")
POSES_WRONG = _warning(
    "Poses wrong: they show another place or time",
    "They do not follow gyro and vehicle model.",
    "Check their source and its clock.",
)
CAMERA_WRONG = _warning(
    "Camera wrong: it shows another place or time",
    "Pictures do not follow gyro and vehicle model.",
    "Check the video source.",
)

# Thrusters and commands

LATENCY_NORMAL = _info("Command latency is back to normal")
LATENCY = _warning(
    "Command latency {delay_s:.1f} s: check the tether",
    "Time from command to motion.",
    "Check network and flight controller load too.",
)
REDUNDANT_LOSS = _warning(
    "One of {names} gives {percent:.0f} % of its thrust",
    "The motion does not show which of these redundant thrusters.",
    "Test each with a motor test.",
)
REDUNDANT_RESTORED = _info("{names} give their full thrust again")
THRUSTER_LOSS = _warning(
    "Thruster {name} gives {percent:.0f} % of its thrust",
    "The allocation accounts for it.",
    "Clear its propeller; if it is damaged set THRn_HEALTH.",
)
THRUSTER_RESTORED = _info("Thruster {name} gives its full thrust again")
THRUSTERS_UNJUDGED = _info("Thrust not estimated, used too little: {names}", "A loss could not be seen in this flight.")
NO_FREE_PATH = _warning("No free path to the goal: holding; move the goal")
FENCE_TOO_NEAR = _warning("New fence: {lack_m:.2f} m too near, moving out")
FENCE_GAP = _warning("{text}", "A gap in the fence or between obstacles that no leg needs (FENCE_GAP_CHK).")
MOTOR_TEST = _info("Motor test: {number} {name}{limit}", "", "Keep hands off.")
MOTOR_TEST_OVER = _info("Motor test over")
MOTOR_TEST_ENDED = _info("Motor test over: {reason}")

# Sensors and devices

DEVICE_FAILED = _critical("{device} failed: {reason}", "Repeated every 5 s.", "Check its cable, power and port.")
DEVICE_WORKS = _info("{device}: working again")
BATTERY_IMPLAUSIBLE = _warning("Battery readings implausible: check the monitor", "Not finite or negative; not used.")
BATTERY_VOLTAGE_IMPLAUSIBLE = _warning(
    "Battery voltage {voltage_v:.1f} V, plausible {low_v:.3g} to {high_v:.3g} V: check monitor, vehicle file",
)
CAMERA_DARK = _warning("Camera black: remove its cover, switch on light")
CAMERA_BRIGHT = _warning("Camera over-exposed: shorten exposure, dim light")
CAMERA_FLAT = _warning("Camera shows one grey level: check lens, cable")
CAMERA_TORN = _warning("Camera pictures are torn: check its cable")
CAMERA_FROZEN = _warning("Camera frozen, same picture again: restart it")
CAMERA_WRONG_SIZE = _warning("Picture size is not the vehicle file's: check it", "The calibration does not apply.")
CAMERA_WRONG_TYPE = _warning("Camera sends no 8-bit pictures: set its format")
CAMERA_FOGGY = _warning("Camera foggy: clean its lens, or water is turbid")
CAMERA_SILENT = _warning("Camera sends no pictures: check its cable")
CAMERA_WORKS = _info("Camera works again")
PHOTOS_STOPPED = _warning("Photos stopped: {reason}")
PHOTOS_SKIPPED = _warning("Photos skipped: camera too slow, ask less often")
PHOTO_FAILED = _warning("Photo {index} failed: {reason}")
FLOOR_LOST = _warning("No range to the floor: holding depth")
FLOOR_BACK = _info("Range to the floor is back: holding height")
IN_OBSTACLE = _warning(
    "Obstacle of {size_m:.0f} m ignored: it covers the vehicle", "", "Correct the system that reports it."
)

# Missions

MISSION_COMPLETE = _info("Mission complete, laps: {laps}{skipped}")
MISSION_CHANGED = _warning("Mission changed while it ran: holding, start again")
MISSION_GONE = _warning("Mission cleared while it ran: holding, upload one to go on")
REACHED = _info("Reached item {seq}")
REACHED_SEVERAL = _info("Reached items {seqs}")
REACHED_MANY = _info("Reached {count} items, the last is item {seq}")
OUT_OF_REACH = _warning("{name} out of reach: {reason}", "No progress for WP_STUCK_TIME.")
ITEM_SKIPPED = _warning("Skipped item {seq}, out of reach: {reason}", "No progress for WP_STUCK_TIME.")
ITEM_HELD = _warning(
    "Holding: item {seq} out of reach, {reason}",
    "No progress for WP_STUCK_TIME.",
    "Move the item or wait for less current.",
)
UPSTREAM = _warning(
    "{leg}", "The current leaves little speed over ground on a leg.", "Raise the speed, move or reverse the leg."
)
HOME_KEPT = _warning("Home unchanged: {reason}")
PLAN_HOLD = _warning("Holding: {problem}", "A change made the running plan invalid.", "Correct the plan, start again.")
PLAN_NO_START = _warning(NO_START + "{problem}", "", "Correct the plan.")
PLAN_OK = _info("Plan ok", "It may be started again.")
ITEM_ORDER_FAILED = _warning("Item {seq}: {reason}", "Refused; the mission goes on.")
SURFACED = _info("Surfaced", "And disarmed.")
DIVED = _info("Dived to {depth_m:.2f} m: holding")
CIRCLE_DONE = _info("Circle done: holding")
SETPOINTS_STOPPED = _warning(
    "Set points stopped: holding", "None for OFFB_TIMEOUT.", "Check the client that sends them."
)

# MAVLink: links, keys and control

GREETING = _info("{name} {version}, {note}", "To each client, 2 s after its first message.")
GREETING_REFUSAL = _warning("No arming: {reason}", "A reason that a client cannot see otherwise.")
KEY_UNKNOWN = _warning("Frames with an unknown key rejected: check the key", "", "Give the client the key.")
UNSIGNED = _warning("Unsigned frames rejected: sign them", "", "Give the client the key.")
SIGNED_TOO_OLD = _warning("Signed frames rejected, too old: check the clock")
FRAMES_REFUSED = _warning("frames rejected so far: {counts}")
FLOODED = _warning(
    "{sender} floods its link: throttled", "A client sends more than is processed.", "Lower its message rates."
)
FLOODED_BYTES = _warning("{sender} on link {link}: {lost} bytes dropped, {total} in all")
HIGH_LATENCY = _info("link {link}: high latency", "For the log: the link carries HIGH_LATENCY2.")
HIGH_LATENCY_OVER = _info("link {link}: high latency is over")
SIGNING_NOT_SAVED = _warning("Signing key or time not saved: {problem}", "A restart loses it.", "Check the disk.")
KEY_FROM_NETWORK = _warning("Key refused: use `autopilot mavlink key` on board")
KEY_WHILE_ARMED = _warning("Key refused: disarm first")
KEY_UNSIGNED = _warning("Key refused: sign it with the present key")
KEY_ZERO = _warning("Key refused: it is all zero")
SIGNING_ON = _warning("Signing on: only signed frames are accepted (key set by {client})")
SIGNING_OFF = _warning("Signing off (key set by {client})")
OPERATOR_SILENT = _warning(
    "Operator {system} silent: nobody in control", "No heartbeat for FS_GCS_TIMEOUT.", "Take control."
)
OPERATOR_RELEASED = _info("Operator {system} released control", "Every client may command.")
OPERATOR_IN_CONTROL = _info("Operator {system} is in control", "Others may only watch.")
OPERATOR_ASKS = _info("Operator {system} asks for control", "", "Release control.")
REFUSED = _warning("{reason}", "Why a command, set point, parameter or message was refused.")

# MAVLink: plans, parameters, logs, sticks

PLAN_ACCEPTED = _info("{kind} plan accepted: {count} items{home}", "In force and on disk.")
PLAN_REFUSED = _warning("{kind} refused: {reason}", "The plan in force stays.", "Correct the item, upload again.")
PLAN_DENIED = _warning("{kind} change denied: client {client} is uploading, try again later")
PLAN_NOT_ON_DISK = _warning("Plan in force, not on disk yet", "The disk is slow; a restart may lose it.")
PLAN_CLEARED = _info("cleared: {names}")
PLAN_NOT_CLEARED = _warning("Not cleared ({names}): {reason}", "The plan in force stays.")
UPLOAD_CANCELLED = _info("{kind} upload cancelled by the client")
MISSION_UNFENCED = _warning(
    f"Mission{{size}} with {NO_FENCE}: upload its fence, or keep clear of walls",
)
PARAMETER_SET = _info("parameter {name} = {value:g} (was {before:g})")
PARAMETER_STUB = _warning("{name} is read only: {remedy}")
PACKED_PARAMETERS = _info("param.pck: only under profile ardusub, use param fetch")
EXTENDED_PARAMETERS = _info("PARAM_EXT is not served: use PARAM_REQUEST_LIST")
PARAMETER_UNKNOWN = _warning("There is no parameter {name}: PARAM_REQUEST_LIST lists them")
PARAMETER_TYPE = _warning("parameter {name} is {type}: other types are refused")
PARAMETERS_RESET = _warning("Parameters set to defaults by {client}: {count}")
PARAMETERS_SAVED = _info("Parameters are saved now")
PARAMETERS_NOT_SAVED = _warning("Not saved ({failure}), lost at restart: {names}", "", "Check the disk.")
PARAMETER_NOT_ON_DISK = _warning("{name} in force, not on disk yet", "The disk is slow; a restart may lose it.")
LOGS_ERASING = _warning("All logs are being erased: asked for by {client}")
LOGS_ERASED = _info("Logs erased: {count}")
LOGS_ARMED = _warning("Logs not erased: disarm first")
LOGS_NO_FOLDER = _warning("Logs not erased: there is no log folder")
LOGS_NOT_ERASED = _warning("Logs not erased: {error}")
LOG_MISSING = _warning("There is no log {number}: list the logs again")
LOG_UNREADABLE = _warning("Log {number} cannot be read: list the logs again")
STICKS_UNUSED = _info("Pitch and roll sticks have no effect here", "MANUAL_CONTROL: x, y, z and r are used.")
STICKS_OF_ANOTHER = _warning("Sticks ignored: {client} steers", "One client steers at a time.")
STICK_BELOW_ZERO = _notice("Vertical stick below 0: interpreted as PILOT_Z 1", "Range -1000 to 1000, neutral 0.")
STICK_NOT_CENTRED = _warning(
    "Vertical stick not used until it rests at {neutral}: see PILOT_Z", "", "Centre the stick."
)
PILOT_GAIN = _info("Pilot gain {percent:.0f} %")
BUTTON_UNKNOWN = _warning("Button {button}: function {function} is not offered, see BTNn_FUNCTION")
ARMING_REASON = _warning(ARMING_CHECK + "{reason}", "Answer to RUN_PREARM_CHECKS, one for each reason.")
ARMING_UNFENCED = _notice(f"{ARMING_CHECK}{NO_FENCE}, which FENCE_REQUIRED allows", "Answer to RUN_PREARM_CHECKS.")
ARMING_PASSED = _info("Arming checks passed")
ODOMETRY_FRAME = _warning("ODOMETRY in frame {frame} is not used: send MAV_FRAME_LOCAL_NED (1) or LOCAL_FRD (20)")
SECOND_POSES = _warning("Poses of {second} not used: {first} sends some")

# Controller

SOLVER = _debug("Solver: {name}")
SLOWER_SOLVER = _warning(
    "Slower solver ({name}): see log, reinstall",
    "The compiled solver is switched off, fails its self-test or does not support this number of thrusters.",
)
FALLBACK_SHIFTED_PLAN = _warning(FALLBACK_TEXT + ", last plan goes on")
FALLBACK_HOLDING = _warning(FALLBACK_TEXT + ", holding position", "Station keeping by a simpler controller.")
FALLBACK_OVER = _info("Controller has solutions again")
CONTROL_NOT_FINITE = _error(
    "Estimate not finite: thrusters neutral, recover it", "The controller was given NaN or infinity.", "Keep the log."
)
CONTROL_FINITE = _info("Estimate finite again after {count} ticks without thrust")
LIMITS_GIVEN_UP = _warning(
    "No plan keeps all limits: give room or take over",
    "A soft limit is violated for a second: beyond the fence, or an obstacle too near.",
    "Move fence, obstacle or goal.",
)
CERTIFICATE = _debug("{name}: {text}", "Guaranteed at this goal.")
NO_CERTIFICATE = _debug("{name}: no certificate: {error}")
LIPSCHITZ = _debug("{text}", "Bound on the model's prediction error.")
GOAL_BEYOND_LIMIT = _warning("{name}: no margin left to the {limit} limit, move it")
GOAL_LACKS_THRUST = _warning("{name}: too little {limit} to stay there", "", "Move the goal.")
GOAL_LACKS_YAW_RATE = _warning("{name}: SPD_YAW_MAX leaves nothing to stay with", "", "Raise SPD_YAW_MAX.")
GOAL_IN_CURRENT = _warning(
    "{name}: current {current_m_s:.2f} m/s, too fast to stay", "Faster than the vehicle.", "Move the goal."
)
BUOYANCY_BEYOND_THRUST = _warning(
    "Too {trim} for its thrusters: trim the vehicle", "Estimated buoyancy exceeds the vertical thrust."
)
BUOYANCY_OFF = _warning("{way} than its file by {force_n:.1f} N: trim it", "", "Change ballast or the vehicle file.")
WORK_FAILED = _debug("{work}: {kind}: {error}", "An exception in background work.")
NO_ENERGY_PLAN = _warning("No energy plan: flying the plain route", "The reason is in the log.")
ROUTE_SEARCH_FAILED = _warning("Route search failed: holding, send another goal", "The exception is in the log.")

# Service, links and drivers

START_WARNING = _warning("{text}", "A warning from the start of the service.")
PLANS_NOT_SAVED = _warning("Plans not saved: {cause}", "A restart loses the present plans.", "Check the disk.")
LOG_STOPPED = _warning("Log stopped: {cause}", "Nothing is recorded until the next arming.", "Check the disk.")
LOG_DISK_SLOW = _warning("Log loses messages: disk too slow")
LOG_INCOMPLETE = _warning("Log misses messages: internal fault", "", "Report it.")
STATE_NOT_KEPT = _warning(
    "No arming: {text}", "Stored plans or parameters are lost or differ.", "Check them, then set STATE_ACCEPT."
)
STATE_ACCEPTED = _warning("Accepted by the operator: {text}", "It no longer prevents arming.")
LINK_PROBLEM = _warning("{name}: {problem}", "A MAVLink link failed.", "Check cable and port.")
LINK_WARNING = _warning("{text}", "A port or client of a link was refused or dropped.")
LINK_NEWS = _info("{text}", "A link's port or clients have changed.")
LINK_BACK = _info("{name}: back")
VIEW = _info("View: {text}", "The simulation was changed from the live view.")
FOUND_ARMED = _critical("Flight controller found ARMED: disarm it first")
PAYLOAD_REFUSED = _warning("{text}")
DEVICE_CONNECTED = _notice("{name}: connected")
DEVICE_RECONNECTED = _notice("{name}: reconnected")
DEVICE_DOWN = _warning("{name}: down: {problem}")
DEVICE_SILENT = _warning("{name}: silent: check power and settings", "Open, but no data arrive.")
DEVICE_HEARD = _notice("{name}: working again")
CLOCK_JUMPED = _warning("{what}{used}: check power, time sync", "A sensor's time stamps jumped or stand still.")

ROWS: dict[str, Row] = {name: row for name, row in tuple(globals().items()) if isinstance(row, Row)}
"""Identifier -> row, in the order of this file."""
