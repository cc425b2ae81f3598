"""The table of sensors, one row per kind: sample classes, drivers, simulation, use by the estimator.

Drivers, simulation, estimator, doctor and view use this table. Classes are given as ``module:Class`` and imported on
use, so that this module depends on none. The logging of samples is defined in :mod:`autopilot.log.sample_table`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorRow:
    device: str
    """Its table in ``[devices]`` and in a scenario's ``[sensors]``, its name in faults and in the view."""
    label: str
    """As operators know it."""
    measures: str = ""
    """What it measures, for the doctor; "" = nothing that he looks at."""
    samples: tuple[str, ...]
    """Its samples: classes of :mod:`autopilot.core.samples`."""
    reading: str = ""
    """Attribute of a sample whose last digits are noise: one that repeats itself has said nothing new."""
    drivers: Mapping[str, str] = field(default_factory=dict)
    """Name of a driver -> its class."""
    table: str = ""
    """Of the vehicle file: where it sits, its rate, latency and time offset."""
    simulated: str = ""
    """Class of one that a scenario may have or not (:class:`autopilot.sitl.optional_sensors.OptionalSensor`)."""
    aids: tuple[str, ...] = ()
    """Aiding measurements of the estimator that are made of it (:mod:`autopilot.estimator.sources`)."""
    aid: str = ""
    """Class of that measurement, where nothing else in the estimator names it
    (:class:`autopilot.estimator.aiding.ScalarAid`)."""
    controller_message: str = ""
    """Of a flight controller that measures it too."""
    replaces: bool = False
    """Beside a flight controller that measures it too, the device of its own counts."""

    @property
    def kinds(self) -> tuple[type, ...]:
        module = import_module("autopilot.core.samples")
        return tuple(getattr(module, name) for name in self.samples)


SENSOR_ROWS = (
    SensorRow(
        device="ahrs",
        label="AHRS",
        measures="attitude",
        samples=("AhrsSample", "ImuSample"),
        reading="rate_frd_rad_s",
        drivers={"ellipse": "autopilot.drivers.ellipse:Ellipse", "ig500": "autopilot.drivers.ig500_device:Ig500Device"},
        table="ahrs",
        aids=("heading", "model"),
        replaces=True,
    ),
    SensorRow(
        device="camera",
        label="Camera",
        measures="pictures",
        samples=("CameraFrame",),
        drivers={
            "opencv": "autopilot.drivers.opencv_camera:OpenCvCamera",
            "playback": "autopilot.drivers.playback:Playback",
        },
    ),
    SensorRow(
        device="depth",
        label="Depth sensor",
        measures="depth",
        samples=("DepthSample",),
        drivers={"ms5837": "autopilot.drivers.ms5837:Ms5837"},
        table="depth_sensor",
        simulated="autopilot.sitl.optional_sensors:SimDepthSensor",
        aids=("depth",),
        aid="autopilot.estimator.measure_depth:DepthAid",
        controller_message="SCALED_PRESSURE2",
        replaces=True,
    ),
    SensorRow(
        device="dvl",
        label="DVL",
        measures="velocity",
        samples=("VelocitySample",),
        reading="vel_frd_m_s",
        drivers={"waterlinked_a50": "autopilot.drivers.waterlinked_a50:WaterLinkedA50"},
        table="dvl",
        simulated="autopilot.sitl.optional_sensors:SimDvl",
        aids=("velocity",),
    ),
    SensorRow(
        device="altimeter",
        label="Altimeter",
        measures="height",
        samples=("AltimeterSample",),
        reading="range_m",
        drivers={"ping1d": "autopilot.drivers.ping1d:Ping1d"},
        table="altimeter",
        simulated="autopilot.sitl.optional_sensors:SimAltimeter",
        aids=("altimeter",),
        aid="autopilot.estimator.measure_range:AltimeterAid",
        replaces=True,
    ),
    SensorRow(
        device="gps",
        label="GPS",
        samples=("GpsSample",),
        table="gps",
        simulated="autopilot.sitl.optional_sensors:SimGps",
        aids=("gps",),
        aid="autopilot.estimator.measure_gps:GpsAid",
    ),
    SensorRow(
        device="battery",
        label="Battery monitor",
        measures="battery",
        samples=("PowerSample",),
        drivers={"ads1115": "autopilot.drivers.ads1115:Ads1115", "ina219": "autopilot.drivers.ina219:Ina219"},
        controller_message="BATTERY_STATUS",
        replaces=True,
    ),
    SensorRow(
        device="leak",
        label="Leak probe",
        measures="leak",
        samples=("LeakSample",),
        drivers={"gpio": "autopilot.drivers.leak_gpio:GpioLeak"},
        replaces=True,
    ),
    SensorRow(device="hull", label="Hull sensor", samples=("HullSample",)),
)

_FIRST_AIDS = ("heading", "model", "markers", "external", "velocity", "depth", "laser")
_MORE_AIDS = (aid for row in SENSOR_ROWS for aid in row.aids if aid not in _FIRST_AIDS)

AID_SENSORS = (*_FIRST_AIDS, *_MORE_AIDS)
"""Aiding sensors of the estimator, in the order in which measurements of the same time are used. Logs count them by
their places here: new ones come last."""
