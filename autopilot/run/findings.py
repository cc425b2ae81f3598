"""Findings of ``doctor``: severity, text and remedy."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

from autopilot.core.errors import ConfigError
from autopilot.drivers.devices import DeviceSetup
from autopilot.drivers.links import Connection, parse_connection


class FindingSeverity(Enum):
    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    verdict: FindingSeverity
    what: str
    found: str
    remedy: str = ""


_SILENT = {
    "udpin": "nothing arrives at UDP port {number} of {address}: let the device send there, check firewall and network",
    "udpout": "{address}:{number} (UDP) does not answer: check address, port, firewall, and that the device is on",
    "udpbcast": "nobody answers the broadcast to {address}:{number}: check network mask and firewall",
    "tcpin": "nobody has connected to TCP port {number}: connect from the device, check the firewall",
    "tcpout": "{address}:{number} (TCP) says nothing: check address, port, firewall, and that the device is on",
    "serial": "serial line {address} is silent: check power, {number} baud, and that TX and RX are crossed",
}
_SLOW = {
    "serial": "check {number} baud, the device's rate or divider, and the load of this machine",
    "": "check the rate that the sender is set to, the network, and the load of this machine",
}


def silent_remedy(setup: DeviceSetup) -> str:
    """Remedy for an open device that sends nothing."""
    return _filled(setup, _SILENT) or "check power and settings"


def slow_remedy(setup: DeviceSetup | None) -> str:
    """Remedy for a device whose rate is too low."""
    return "" if setup is None else _filled(setup, _SLOW)


def _filled(setup: DeviceSetup, texts: dict[str, str]) -> str:
    line = _connection(setup.options)
    if line is not None:
        text = texts.get(line.kind, texts.get("", ""))
        return text.format(address=line.address, number=line.number)
    bus, source = getattr(setup.options, "bus", None), getattr(setup.options, "source", None)
    if bus is not None:
        return f"check wiring and power at /dev/i2c-{bus} (i2cdetect -y {bus})"
    if source is not None:
        return f"check that {source} delivers pictures, its cable or network, and the light"
    return texts.get("", "")


def _connection(options: Any) -> Connection | None:
    """Configured connection of a device, None if it is on no link."""
    connect, host = getattr(options, "connect", None), getattr(options, "host", None)
    port, baud = getattr(options, "port", None), getattr(options, "baud", None)
    try:
        if connect is not None:
            return parse_connection(connect)
        if host is not None and isinstance(port, int):
            return Connection(text=host, kind="tcpout", address=host, number=port)
        if isinstance(port, str) and baud is not None:
            return Connection(text=port, kind="serial", address=port, number=baud)
    except ConfigError:
        return None
    return None
