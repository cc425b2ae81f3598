"""What a log holds: every topic with its type."""

from autopilot.core.errors import LogError
from autopilot.log.sample_table import SAMPLE_ROWS

AID_PREFIX = "/nav/aid/"

TOPICS: dict[str, str] = {
    "/sim/truth": "autopilot_msgs/VehicleState",
    "/sim/thrusters": "autopilot_msgs/ThrusterState",
    "/sim/contact": "autopilot_msgs/ContactState",
    "/sim/payload": "autopilot_msgs/PayloadTruth",
    "/nav/state": "autopilot_msgs/VehicleState",
    "/nav/covariance": "autopilot_msgs/NavCovariance",
    "/nav/status": "autopilot_msgs/NavStatus",
    "/nav/thrust": "autopilot_msgs/ActingThrust",
    "/nav/external": "autopilot_msgs/ExternalPose",
    "/nav/counters": "autopilot_msgs/NavCounters",
    "/nav/shadow": "autopilot_msgs/ShadowStatus",
    "/nav/fit": "autopilot_msgs/MarkerFit",
    "/ctl/goal": "autopilot_msgs/Goal",
    "/ctl/drive": "autopilot_msgs/Drive",
    "/ctl/nmpc": "autopilot_msgs/NmpcStatus",
    "/ctl/horizon": "nav_msgs/Path",
    "/ctl/route": "nav_msgs/Path",
    "/ctl/plan": "autopilot_msgs/EnergyPlan",
    "/out/thrusters": "autopilot_msgs/ThrusterCommand",
    "/out/mavlink": "autopilot_msgs/MavlinkFrame",
    "/ctl/thrusters": "autopilot_msgs/ThrusterHealth",
    "/mission/progress": "autopilot_msgs/MissionProgress",
    "/sys/mode": "autopilot_msgs/ModeState",
    "/sys/loop": "autopilot_msgs/LoopStats",
    "/sys/process": "autopilot_msgs/ProcessStats",
    "/sys/parameters": "autopilot_msgs/ParameterChange",
    "/in/tick": "autopilot_msgs/InputTick",
    "/in/step": "std_msgs/String",
    **{row.topic: f"autopilot_msgs/{row.type}" for row in SAMPLE_ROWS},
    "/in/ahrs": "sensor_msgs/Imu",
    "/in/camera": "sensor_msgs/CompressedImage",
    "/in/camera_info": "sensor_msgs/CameraInfo",
    "/in/laser": "sensor_msgs/Range",
    "/in/power": "sensor_msgs/BatteryState",
    "/in/below": "autopilot_msgs/Below",
    "/in/mavlink": "autopilot_msgs/MavlinkFrame",
    "/payload/image": "sensor_msgs/CompressedImage",
    "/payload/outputs": "autopilot_msgs/PayloadOutputs",
    "/payload/still": "autopilot_msgs/Still",
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
        raise LogError(f"topic {topic!r} is not declared; add it to TOPICS in autopilot/log/topics.py") from None
