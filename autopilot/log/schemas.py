"""Message definitions (``ros2msg``) of everything in a log: our own fixed-size types and the standard ones.

Standard definitions follow the ROS 2 ``common_interfaces``, ``geometry2`` and ``rcl_interfaces`` packages without their
comments and constants. Each schema in a file is self-contained: the root definition, then every type that it uses.
"""

from functools import cache

from autopilot.core.errors import LogError
from autopilot.log.cdr import PRIMITIVES, CdrField, CdrLayout, fixed_layout, parse_definition, short_name
from autopilot.log.sample_table import SAMPLE_ROWS

ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"
PROFILE = "ros2"
FRAME_ID_BYTES = 4
"""Every frame of ours has three letters (``ned``, ``frd``, ``cam``, ``map``) and a NUL: fixed-size types stay fixed."""

_SEPARATOR = "=" * 80

_DEFINITIONS: dict[str, str] = {
    # Own types, package autopilot_msgs. SI, NED world, FRD body.
    **{f"autopilot_msgs/{row.type}": f"std_msgs/Header header{row.fields}" for row in SAMPLE_ROWS},
    "autopilot_msgs/VehicleState": """
std_msgs/Header header
float64[3] pos_ned_m  # place
float64[3] rpy_rad  # roll, pitch, yaw
float64[3] vel_frd_m_s  # over ground
float64[3] vel_water_frd_m_s  # relative to the water
float64[3] rate_frd_rad_s  # turn rates p, q, r
float64[3] current_ned_m_s  # of the water
""",
    "autopilot_msgs/ThrusterState": """
std_msgs/Header header
float64[8] thrust_n  # acting force, unused = 0
float64 power_w  # electrical, drawn from the battery: thrusters and everything else
""",
    "autopilot_msgs/ContactState": """
std_msgs/Header header
uint32 count  # contacts begun so far
float64 penetration_m  # deepest now, 0 = none
""",
    "autopilot_msgs/NavCovariance": """
std_msgs/Header header
float64[12] variance  # of pos_ned, rpy, vel_water_frd, current_ned
""",
    "autopilot_msgs/ActingThrust": """
std_msgs/Header header
float64[8] thrust_n  # that the estimator was told, unused = 0
""",
    "autopilot_msgs/NavStatus": """
std_msgs/Header header
uint8 health  # 0 invalid, 1 dead reckoning, 2 good
uint32 reset_count  # jumps of the estimate so far
uint32 doubts  # bits: 1 accelerometer, 2 gyro, 4 fixes, 8 range, 16 map, 32 calibration, 64 resets, 128 camera
""",
    "autopilot_msgs/NavCounters": """
std_msgs/Header header
uint32 resets  # of the filter
uint32 clock_backwards  # times that the clock went back
uint32 thrust_malformed  # thrusts that are not finite
uint32 ahrs_good  # samples taken
uint32 ahrs_malformed  # not finite or out of range
uint32 ahrs_future  # stamped later than now
uint32 ahrs_old  # stamped before one that was taken
uint32 ahrs_stuck  # repeating themselves
uint32 ahrs_blind_steps  # of the filter without an AHRS sample
uint32 ahrs_tilt_disagreements  # tilts that left what gyros and accelerometers say
uint32[8] received  # by sensor: 0 heading, 1 model, 2 markers, 3 external, 4 velocity, 5 depth, 6 laser, 7 altimeter
uint32[8] fused  # 1 = it went into the estimate
uint32[8] rejected  # measurements that failed their test
uint32[8] late  # measurements older than the filter goes back
uint32[8] duplicate  # measurements that came twice
uint32[8] future  # measurements stamped later than now
uint32[8] malformed  # measurements that are not finite or out of range
uint32[8] aid_resets  # resets of the estimate by this sensor
uint32[16] frames  # ok wrong_size wrong_type dark bright flat torn frozen dropped failed late foggy
uint32 markers_unknown  # markers that the map does not have
uint32 markers_misfit  # markers left out because they did not fit
uint32 markers_leaning  # fixes refused because they leaned
uint32 shadow_disagreements  # times that the estimators parted
uint32 doubt_accel  # times that the accelerometer was doubted
uint32 doubt_gyro  # times that the gyros were doubted
uint32 doubt_compass_jumps  # of the heading source
uint32 doubt_jumps  # of the estimate
uint32[4] devices  # ticks on which it failed: 0 sensors, 1 camera, 2 thrusters, 3 their watchdog
uint32 power_malformed  # readings of the battery that were refused: not finite, or none that it can have
uint32 faults  # inside the service
uint32 other  # counted, and not one of these
uint32 ahrs_field_disturbances  # how often the magnetometer ceased to be believed
""",
    "autopilot_msgs/ShadowStatus": """
std_msgs/Header header
float64[3] pos_difference_ned_m  # flown minus shadow
float64 yaw_difference_rad  # flown minus shadow
float64[3] vel_difference_frd_m_s  # flown minus shadow
float64 ratio  # largest difference over its bound
uint8 disagrees  # 1 = beyond the bounds for long enough
""",
    "autopilot_msgs/AidStatus": """
std_msgs/Header header
float64[3] innovation  # measurement minus prediction, unused = 0
float64[3] innovation_var  # its variance by the filter, unused = 0
float64 test_ratio  # squared innovation over its gate, above 1 = rejected
uint8 fused  # 1 = it went into the estimate
uint8 state  # 0 stopped, 1 starting, 2 active, 3 rejecting
float64 age_s  # of the measurement when it was used
""",
    "autopilot_msgs/MarkerFit": """
std_msgs/Header header
uint16 known  # markers of the picture that were matched with the map
uint16 used  # of these the pose stands on; the others did not fit
float64 rms_px  # of the distances of all corners used from where map, camera and pose have them
float64 worst_px  # the largest of them
""",
    "autopilot_msgs/Goal": """
std_msgs/Header header
float64[3] pos_ned_m  # place
float64 yaw_rad  # heading from north
uint8 yaw_free  # 1 = any heading will do
float64 speed_m_s  # to be flown in the water
float64 accept_radius_m  # inside it the place is reached
float64 accept_yaw_rad  # and within it the heading
int32 seq  # mission item, -1 none
""",
    "autopilot_msgs/Drive": """
std_msgs/Header header
uint8 active  # 0 = the goal is a place, and nothing below counts
float64 north_m_s  # over ground; both 0 = the goal's place is held
float64 east_m_s  # the same
float64 turn_rad_s  # the direction of that velocity turns so fast
float64 down_m_s  # NaN = the goal's depth
float64 yaw_rate_rad_s  # NaN = the goal's heading
float64 yaw_trend_rad_s  # so fast the goal's heading itself turns
""",
    "autopilot_msgs/NmpcStatus": """
std_msgs/Header header
uint8 status  # 0 ok, 1 idle, 2 not finite, 3 residual, 4 exception
uint8 fallback  # 0 none, 1 shifted plan, 2 station keeping, 3 neutral
uint16 iterations  # quadratic programs solved in this step
float64 solve_s  # CPU time of the whole control step
float64 cost  # of the program solved; only differences mean something
float64 slack_max  # largest violation of a soft limit in the prediction
float64 margin_m  # smallest tightened clearance in the prediction
float64 tube_m  # largest distance kept from boundaries beyond the body
float64 penalty_use  # largest multiplier of a soft limit over its penalty
float64 lift_n  # learned vertical force beyond the vehicle file's buoyancy, positive pushes up
""",
    "autopilot_msgs/ThrusterCommand": """
std_msgs/Header header
float64[8] thrust_n  # force of each thruster, unused = 0
uint16[8] pwm_us  # pulse lengths, unused = 0
""",
    "autopilot_msgs/ThrusterHealth": """
std_msgs/Header header
float64[8] effectiveness  # 0..1, what bounds and allocation go by, unused = 0
float64[8] estimate  # from the motion
float64[8] sigma  # its standard deviation
""",
    "autopilot_msgs/EnergyPlan": """
std_msgs/Header header
int32 seq  # mission item that it leads to, -1 none
float64 eta_s  # to the goal's region
float64 energy_j  # to the goal's region, hotel power included
float64 trajectory_s  # planned so far
uint32 late  # plans that came late
""",
    "autopilot_msgs/MissionProgress": """
std_msgs/Header header
int32 current_seq  # mission item that is flown, -1 none
int32 reached_seq  # -1 none
uint16 lap  # laps that are complete
uint8 state  # MISSION_STATE
""",
    "autopilot_msgs/ModeState": """
std_msgs/Header header
uint8 armed  # 1 = thrusters may turn
uint32 custom_mode  # as in HEARTBEAT; names are in run.json
uint32 failsafes  # bits: docs/failsafes.md
""",
    "autopilot_msgs/ParameterChange": """
std_msgs/Header header
uint8[16] name  # ASCII, padded with zeros
float64 value  # the new one
""",
    "autopilot_msgs/LoopStats": """
std_msgs/Header header
float64 tick_s  # longest tick of the last second
float64 cpu_s  # CPU seconds of the last second
uint32 overruns  # ticks that began late, so far
uint32 dropped_log  # messages lost so far
uint32 dropped_frames  # pictures that detection did not follow
uint8 late_part  # what most of the slowest tick of the second went into: 0 wait, 1 device, 2 vision, 3 receive
float64[12] part_s  # its wall time: as late_part, 4 estimate, 5 mavlink, 6 decide, 7 control
float64[12] part_cpu_s  # its CPU time: as part_s, 8 allocate, 9 write, 10 send, 11 record
""",
    "autopilot_msgs/ProcessStats": """
std_msgs/Header header
uint64 rss  # bytes of memory that are resident, 0 = the system does not say
uint32 log_queue  # messages that wait for the writer of the log
uint64 log_queue_bytes  # what they take
uint16 threads  # of the process
float64 collect_s  # longest pause of the garbage collector in the last second
""",
    "autopilot_msgs/InputTick": """
std_msgs/Header header
uint16 samples  # inputs that follow in the file and belong to this tick
uint16 frames  # MAVLink datagrams of this tick
uint32 overruns  # ticks that began late, so far
float64 cpu_load  # 0..1, 0 = not measured
""",
    "autopilot_msgs/PayloadOutputs": """
std_msgs/Header header
uint16[16] pulse_us  # of [[payload]] in the order of the vehicle file, unused = 0
""",
    "autopilot_msgs/PayloadTruth": """
std_msgs/Header header
float64[16] share  # where each really is: 0 dark, off, closed; 1 bright, on, open; unused = 0
""",
    "autopilot_msgs/Still": """
std_msgs/Header header  # time of the exposure, as that of its picture in /payload/image
uint32 index  # number of the still in this run
int32 seq  # mission item that asked for it, -1 = a client
uint8 stored  # 0 = there is no picture: see /rosout
uint8 pose_known  # 0 = there was no estimate then, and the pose is not meant
float64[3] pos_ned_m  # of the vehicle at the exposure, as estimated
float64[3] rpy_rad  # roll, pitch, yaw
float64[6] variance  # of both
uint16 width_px  # of the picture
uint16 height_px  # of the picture
uint32 size  # bytes
float64 delay_s  # from the exposure until it was stored
""",
    "autopilot_msgs/Below": """
std_msgs/Header header
uint8 authority  # 0 ours, 1 the pilot's, 2 stopped
uint8 acts  # whether thrusters do what they are commanded
uint8 thrusters  # so many of pulses_us are known
uint16[8] pulses_us  # what the thrusters get while they do not act for us
uint8[64] text  # its mode, or why it has stopped; UTF-8, zeros behind it
uint8[128] problem  # how its thrusters do something else than what they are commanded, the same
uint8[512] refusals  # why it would not fly for us, the same; lines end with a newline
uint8 armed  # by its heartbeat: 0 no, 1 yes, 2 not known
uint8 rival  # 1 = somebody else commands the thrusters beside us
""",
    "autopilot_msgs/MavlinkFrame": """
std_msgs/Header header
uint8[280] data  # the packet, padded with zeros
uint16 length  # bytes of the packet
uint8 link  # 255 = all links
uint16 client  # of the link: one number per address or connection, 0 = everyone
""",
    # Standard types.
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "nav_msgs/Path": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/Imu": """
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
""",
    "sensor_msgs/Range": """
std_msgs/Header header
uint8 radiation_type
float32 field_of_view
float32 min_range
float32 max_range
float32 range
float32 variance
""",
    "sensor_msgs/BatteryState": """
std_msgs/Header header
float32 voltage
float32 temperature
float32 current
float32 charge
float32 capacity
float32 design_capacity
float32 percentage
uint8 power_supply_status
uint8 power_supply_health
uint8 power_supply_technology
bool present
float32[] cell_voltage
float32[] cell_temperature
string location
string serial_number
""",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify",
    "sensor_msgs/CameraInfo": """
std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi
""",
    # Of Foxglove's schemas: what its image panel draws over a picture.
    "foxglove_msgs/Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a",
    "foxglove_msgs/Point2": "float64 x\nfloat64 y",
    "foxglove_msgs/CircleAnnotation": """
builtin_interfaces/Time timestamp
foxglove_msgs/Point2 position
float64 diameter
float64 thickness
foxglove_msgs/Color fill_color
foxglove_msgs/Color outline_color
""",
    "foxglove_msgs/PointsAnnotation": """
builtin_interfaces/Time timestamp
uint8 type  # 2 closed line
foxglove_msgs/Point2[] points
foxglove_msgs/Color outline_color
foxglove_msgs/Color[] outline_colors
foxglove_msgs/Color fill_color
float64 thickness
""",
    "foxglove_msgs/TextAnnotation": """
builtin_interfaces/Time timestamp
foxglove_msgs/Point2 position
string text
float64 font_size
foxglove_msgs/Color text_color
foxglove_msgs/Color background_color
""",
    "foxglove_msgs/ImageAnnotations": """
foxglove_msgs/CircleAnnotation[] circles
foxglove_msgs/PointsAnnotation[] points
foxglove_msgs/TextAnnotation[] texts
""",
    "rcl_interfaces/Log": """
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
""",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": """
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
string text
string mesh_resource
visualization_msgs/MeshFile mesh_file
bool mesh_use_embedded_materials
""",
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
}


def type_names() -> list[str]:
    """Every type with a definition, as ``package/Name``."""
    return list(_DEFINITIONS)


def own_comments(name: str) -> dict[str, str]:
    """What is said of the fields of ``package/Name``, by name; a field without a comment is left out."""
    found = {}
    for line in _DEFINITIONS[short_name(name)].strip().splitlines():
        head, hash_sign, text = line.partition("#")
        if hash_sign and head.strip():
            found[head.split()[1]] = text.strip()
    return found


@cache
def definition(name: str) -> str:
    """The self-contained schema text of ``package/Name`` or ``package/msg/Name``. LogError if there is none."""
    root = short_name(name)
    if root not in _DEFINITIONS:
        raise LogError(f"message type {name!r} is not known; add its definition to autopilot/log/schemas.py")
    order = [root]
    for kind in order:
        order += [used for used in _uses(kind) if used not in order]
    parts = [_DEFINITIONS[root].strip()]
    parts += [f"{_SEPARATOR}\nMSG: {kind}\n{_DEFINITIONS[kind].strip()}" for kind in order[1:]]
    return "\n".join(parts) + "\n"


def _uses(name: str) -> list[str]:
    kinds = [line.split()[0].split("[")[0] for line in _DEFINITIONS[name].strip().splitlines()]
    return [kind for kind in dict.fromkeys(kinds) if kind not in PRIMITIVES and kind != "string"]


@cache
def types_of(name: str) -> dict[str, tuple[CdrField, ...]]:
    """Parsed definition of ``name`` and of every type that it uses."""
    return parse_definition(name, definition(name))


@cache
def layout(name: str) -> CdrLayout:
    """Layout of one of the fixed-size types, with our frame ids. LogError if the type is not fixed-size."""
    found = fixed_layout(types_of(name), name, FRAME_ID_BYTES)
    if found is None:
        raise LogError(f"message type {name!r} is not fixed-size; write it with CdrBuffer")
    return found


def ros_name(name: str) -> str:
    """The full ROS 2 name ``package/msg/Name`` of ``package/Name``: what a schema record carries."""
    package, _, kind = short_name(name).partition("/")
    return f"{package}/msg/{kind}"
