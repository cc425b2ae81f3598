"""Topics of a log with their types."""

from autopilot.core.errors import LogError
from autopilot.log.record_table import RECORD_ROWS
from autopilot.log.sample_table import SAMPLE_ROWS

AID_PREFIX = "/nav/aid/"

TOPICS: dict[str, str] = {
    "/ctl/horizon": "nav_msgs/Path",
    "/ctl/route": "nav_msgs/Path",
    **{topic: f"autopilot_msgs/{row.type}" for row in RECORD_ROWS for topic in row.topics},
    "/nav/external": "autopilot_msgs/ExternalPose",
    "/in/step": "std_msgs/String",
    **{row.topic: f"autopilot_msgs/{row.type}" for row in SAMPLE_ROWS},
    "/in/ahrs": "sensor_msgs/Imu",
    "/in/camera": "sensor_msgs/CompressedImage",
    "/in/camera_info": "sensor_msgs/CameraInfo",
    "/in/laser": "sensor_msgs/Range",
    "/in/power": "sensor_msgs/BatteryState",
    "/payload/image": "sensor_msgs/CompressedImage",
    "/rosout": "rcl_interfaces/Log",
    "/viz/pose": "geometry_msgs/PoseStamped",
    "/viz/truth": "geometry_msgs/PoseStamped",
    "/viz/path": "nav_msgs/Path",
    "/viz/body": "visualization_msgs/MarkerArray",
    "/viz/current": "visualization_msgs/MarkerArray",
    "/viz/detections": "foxglove_msgs/ImageAnnotations",
    "/viz/markers": "visualization_msgs/MarkerArray",
    "/viz/tf": "tf2_msgs/TFMessage",
}
"""Topic -> message type. ``/nav/aid/<sensor>`` comes on top, one topic per aiding source."""


def type_of(topic: str) -> str:
    """Message type of a topic. LogError if no such topic is declared."""
    if topic.startswith(AID_PREFIX):
        return "autopilot_msgs/AidStatus"
    try:
        return TOPICS[topic]
    except KeyError:
        raise LogError(
            f"topic {topic!r} is not declared; add it to autopilot/log/record_table.py or topics.py"
        ) from None
