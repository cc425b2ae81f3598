"""Message definitions (``ros2msg``) of everything in a log: our own fixed-size types and the standard ones.

Standard definitions follow the ROS 2 ``common_interfaces``, ``geometry2`` and ``rcl_interfaces`` packages without their
comments and constants. Each schema in a file is self-contained: the root definition, then every type that it uses.
"""

from functools import cache

from autopilot.core.errors import LogError
from autopilot.log import record_table, sample_table
from autopilot.log.cdr import PRIMITIVES, CdrField, CdrLayout, fixed_layout, parse_definition, short_name

ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"
PROFILE = "ros2"
FRAME_ID_BYTES = 4
"""Every frame of ours has three letters (``ned``, ``frd``, ``cam``, ``map``) and a NUL: fixed-size types stay fixed."""

_SEPARATOR = "=" * 80


def _own_types(text: str) -> dict[str, str]:
    """Definitions of paragraphs that begin with a type's name."""
    parts = [(part.split(maxsplit=1)[0], part) for part in text.strip().split("\n\n")]
    return {f"autopilot_msgs/{name}": "std_msgs/Header header" + part.removeprefix(name) for name, part in parts}


_DEFINITIONS: dict[str, str] = {
    # Own types, package autopilot_msgs. SI, NED world, FRD body.
    **_own_types(sample_table.FIELDS),
    **_own_types(record_table.FIELDS),
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
    # Foxglove's schemas of image annotations.
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


@cache
def definition(name: str) -> str:
    """The self-contained schema text of ``package/Name`` or ``package/msg/Name``. LogError if it is unknown."""
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
    """The full ROS 2 name ``package/msg/Name`` of ``package/Name``, as in a schema record."""
    package, _, kind = short_name(name).partition("/")
    return f"{package}/msg/{kind}"
