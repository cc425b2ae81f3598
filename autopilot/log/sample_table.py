"""Table of the sample types in a log: topic, message and class.

Schemas, topics, the packer and the replay are made of this table. A new sensor needs a dataclass in
:mod:`autopilot.core.samples`, its fields and a row here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from autopilot.core.samples import (
    AhrsSample,
    AltimeterSample,
    CameraTiltSample,
    DepthSample,
    ExternalPoseSample,
    GpsSample,
    HullSample,
    ImuSample,
    LaserSample,
    LeakSample,
    MarkerSighting,
    ObstacleTrack,
    PilotSample,
    PlanarFixSample,
    PoseSample,
    PowerSample,
    VelocitySample,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageRow:
    """One kind of message of ours, made of an object."""

    of: type | None = None
    """Class of the object, by whose annotations it is packed; None where ``put`` or ``values`` give all."""
    type: str
    """Its name in ``autopilot_msgs``."""
    frame: str
    known: Mapping[str, str] = field(default_factory=dict)
    """Field for whether an attribute is known -> the attribute."""
    put: Mapping[str, Callable[[Any], Any]] = field(default_factory=dict)
    """Field -> its value, where no attribute has its name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleRow(MessageRow):
    of: type
    topic: str
    shapes: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """Of arrays that are not flat."""
    estimator: bool = True
    """The estimator has a use for it."""


FIELDS = """
AhrsRaw
float64[3] rpy_rad  # roll, pitch, yaw
float64[3] rate_frd_rad_s  # turn rates p, q, r
float64[3] accel_frd_m_s2  # specific force

ImuRaw
float64[3] rate_frd_rad_s  # turn rates p, q, r
float64[3] accel_frd_m_s2  # specific force
uint8 mag_known  # 0 = no magnetometer
float64[3] mag_frd  # any unit

MarkerSighting
uint16 count  # markers found
uint16[64] ids  # numbers of the markers, the first `count`
uint8 laser_found  # 1 = the dot was found
float32[512] corners_px  # 64 markers, 4 corners, x and y
float64[2] laser_px  # where the dot is, pixel centres at whole numbers
uint32 decode_us  # time that detection took
float32[64] sigma_px  # of each marker's corners, 0 = not known
float64 stamp_sigma_s  # of t_us from picture to picture, 0 = exact

PoseFix
float64[3] pos_ned_m  # place
float64 yaw_rad  # heading from north
float64[3] sigma_pos_m  # standard deviations
float64 sigma_yaw_rad  # standard deviation

LaserRaw
float64 range_m  # along the beam
float64 sigma_m  # standard deviation

AltimeterRaw
float64 range_m  # of the first echo
float64 sigma_m  # standard deviation
float64 confidence  # 0..1, how sure the device is of it

DepthRaw
float64 depth_m  # below the surface
float64 sigma_m  # standard deviation

VelocityRaw
float64[3] vel_frd_m_s  # velocity, over ground or water by `lock`
float64[3] sigma_m_s  # standard deviations
uint8 lock  # 0 water, 1 bottom

ExternalPose
float64[3] pos_m  # in the frame of `frame`
float64 yaw_rad  # heading from north
uint8 covariance_known  # 0 = the sender gave none
float64[16] covariance  # of position and yaw, by rows
uint8 frame  # 0 NED, 1 FRD
uint32 reset_counter  # of the sender: a change means that its frame has jumped

ObstacleTrack
float64[2] pos_ned_m  # place
float64[2] vel_ned_m_s  # velocity of the obstacle
float64 radius_m  # of the obstacle
uint32 track_id  # number of the obstacle at its sender

PowerRaw
float64 voltage_v  # of the battery
float64 current_a  # drawn from the battery
float64 energy_used_j  # since the battery was full
float64 remaining  # 0..1 of the battery's charge

LeakRaw
uint8 wet  # 1 = water at the probe

HullRaw
float64 pressure_pa  # absolute, inside the hull; NaN not measured
float64 temperature_c  # the same

Gps
float64 lat_deg  # of the antenna
float64 lon_deg  # the same
float64 alt_m  # above mean sea level
float64 sigma_m  # horizontal, each axis

PlanarFix
float64[2] pos_ned_m  # north, east of the antenna
float64 sigma_m  # standard deviation, each axis

CameraTilt
float64 angle_rad  # by the pulse at its servo, upwards positive

PilotRaw
uint8 heard  # 1
"""
"""Name of every type and its fields behind its header, as ``ros2msg``: what has an attribute's name holds it."""

SAMPLE_ROWS = (
    SampleRow(of=AhrsSample, topic="/in/ahrs_raw", type="AhrsRaw", frame="frd"),
    SampleRow(of=ImuSample, topic="/in/imu", type="ImuRaw", frame="frd", known={"mag_known": "mag_frd"}),
    SampleRow(of=MarkerSighting, topic="/in/markers", type="MarkerSighting", frame="cam"),
    SampleRow(of=PoseSample, topic="/in/pose", type="PoseFix", frame="ned"),
    SampleRow(of=LaserSample, topic="/in/laser_raw", type="LaserRaw", frame="frd"),
    SampleRow(of=AltimeterSample, topic="/in/altimeter", type="AltimeterRaw", frame="frd"),
    SampleRow(of=DepthSample, topic="/in/depth", type="DepthRaw", frame="frd"),
    SampleRow(of=VelocitySample, topic="/in/velocity", type="VelocityRaw", frame="frd"),
    SampleRow(
        of=ExternalPoseSample,
        topic="/in/external",
        type="ExternalPose",
        frame="ned",
        known={"covariance_known": "covariance"},
        shapes={"covariance": (4, 4)},
    ),
    SampleRow(of=ObstacleTrack, topic="/in/tracks", type="ObstacleTrack", frame="ned", estimator=False),
    SampleRow(of=PowerSample, topic="/in/power_raw", type="PowerRaw", frame="frd", estimator=False),
    SampleRow(of=LeakSample, topic="/in/leak", type="LeakRaw", frame="frd", estimator=False),
    SampleRow(of=HullSample, topic="/in/hull", type="HullRaw", frame="frd", estimator=False),
    SampleRow(of=GpsSample, topic="/in/gps", type="Gps", frame="wgs", estimator=False),
    SampleRow(of=PlanarFixSample, topic="/nav/gps", type="PlanarFix", frame="ned"),
    SampleRow(of=CameraTiltSample, topic="/in/camera_tilt", type="CameraTilt", frame="frd"),
    SampleRow(
        of=PilotSample, topic="/in/pilot", type="PilotRaw", frame="frd", put={"heard": lambda _: 1}, estimator=False
    ),
)
