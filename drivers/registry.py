"""Back ends by name. A back end is imported on use, so that a missing library affects only its own.

To add one: implement :mod:`.drivers.protocols` in a file of its own, and add a line here, or for a sensor in
:data:`autopilot.core.sensors.SENSOR_ROWS`. :mod:`autopilot.drivers.devices` constructs the devices of ``[devices]``.
"""

from importlib import import_module
from typing import Any

from autopilot.core.errors import ConfigError, DriverError
from autopilot.core.sensors import SENSOR_ROWS

BACKENDS: dict[str, dict[str, str]] = {
    **{row.device: dict(row.drivers) for row in SENSOR_ROWS if row.drivers},
    "thrusters": {
        "pca9685": "autopilot.drivers.pca9685:Pca9685",
        "sabertooth": "autopilot.drivers.sabertooth:Sabertooth",
        "sysfs_pwm": "autopilot.drivers.sysfs_pwm:SysfsPwm",
    },
    "flight_controller": {"ardusub": "autopilot.drivers.ardusub:ArduSub"},
    "link": {
        "udpin": "autopilot.drivers.udp:UdpIn",
        "udpout": "autopilot.drivers.udp:UdpOut",
        "udpbcast": "autopilot.drivers.udp:UdpBroadcast",
        "tcpin": "autopilot.drivers.tcp:TcpServer",
        "tcpout": "autopilot.drivers.tcp:TcpClient",
        "serial": "autopilot.drivers.serial_port:SerialLink",
    },
}
"""Kind -> name -> ``module:class``."""

DEVICE_KINDS = tuple(kind for kind in BACKENDS if kind != "link")
"""Kinds of devices in ``[devices]``, one of each."""


def backend_names(kind: str) -> list[str]:
    if kind not in BACKENDS:
        raise ConfigError(f"no kind of driver is called {kind!r}; use one of {', '.join(BACKENDS)}")
    return sorted(BACKENDS[kind])


def load_backend(kind: str, name: str) -> Any:
    """The class of a back end. ConfigError for an unknown name, DriverError if a library that it needs is missing."""
    names = backend_names(kind)
    if name not in names:
        known = f"use one of {', '.join(names)}" if names else "there is none yet"
        raise ConfigError(f"{kind} driver {name!r} is not known; {known}")
    module_name, _, attribute = BACKENDS[kind][name].partition(":")
    try:
        return getattr(import_module(module_name), attribute)
    except ModuleNotFoundError as error:
        raise DriverError(
            f"{kind} driver {name!r} needs the Python module {error.name!r}, which is not installed; install it"
        ) from error
