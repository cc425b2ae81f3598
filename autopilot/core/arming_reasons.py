"""A reason against arming, with the part of the vehicle and the modes that it concerns."""

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from types import MappingProxyType
from typing import NamedTuple

from autopilot.core.messages import Failsafe


class HealthComponent(IntEnum):
    """A part of the vehicle: its bit in bit sets of the MAVLink events interface, where 0 has to be none."""

    NONE = 0
    SERVICE = 1
    AHRS = 2
    POSITION = 3
    BATTERY = 4
    THRUSTERS = 5
    DEVICES = 6
    HULL = 7
    FENCE = 8
    MISSION = 9
    LINKS = 10
    CONTROLLER = 11


class ModeGroup(IntFlag):
    """Flight modes for which arming has the same conditions."""

    POSITION = 1
    MISSION = 2
    POSITIONLESS = 4
    """A pilot steers without an estimate."""


ALL_MODES = ModeGroup.POSITION | ModeGroup.MISSION | ModeGroup.POSITIONLESS


class ArmingReason(NamedTuple):
    text: str
    """One line: what is wrong, and what to do."""
    component: HealthComponent
    modes: ModeGroup = ALL_MODES
    """In which the vehicle cannot be armed, or (a running one) which cannot be entered."""


COMPONENT_OF: Mapping[Failsafe, HealthComponent] = MappingProxyType(
    {
        rule: component
        for component, rules in {
            HealthComponent.SERVICE: (Failsafe.FAULT, Failsafe.LOOP, Failsafe.LOG, Failsafe.CLOCK),
            HealthComponent.AHRS: (Failsafe.AHRS_STALE, Failsafe.TILT),
            HealthComponent.POSITION: (
                *(Failsafe.NAV_LOST, Failsafe.NAV_CHECK, Failsafe.DEAD_RECKONING, Failsafe.DOUBT),
                Failsafe.ASCENT,
            ),
            HealthComponent.BATTERY: (Failsafe.BATTERY, Failsafe.BATTERY_CRITICAL, Failsafe.ENERGY),
            HealthComponent.THRUSTERS: (Failsafe.THRUSTER, Failsafe.STUCK, Failsafe.WATCHDOG, Failsafe.SENDER),
            HealthComponent.DEVICES: (Failsafe.SENSOR, Failsafe.CAMERA),
            HealthComponent.HULL: (Failsafe.LEAK, Failsafe.PRESSURE, Failsafe.TEMPERATURE, Failsafe.COLLISION),
            HealthComponent.FENCE: (Failsafe.CAGE_SOFT, Failsafe.CAGE_HARD),
            HealthComponent.LINKS: (Failsafe.GCS, Failsafe.PILOT, Failsafe.LATENCY, Failsafe.TETHER),
            HealthComponent.CONTROLLER: (Failsafe.SOLVER,),
        }.items()
        for rule in rules
    }
)
"""The part of the vehicle that a failsafe is about."""
