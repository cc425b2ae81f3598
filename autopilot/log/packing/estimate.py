"""What the estimator says beside the state: how good it is, and what it was made from."""

from autopilot.core.frames import FloatArray
from autopilot.core.messages import (
    MAX_THRUSTERS,
    AidStatus,
    MarkerFit,
    NavCounters,
    NavDoubt,
    NavState,
    ShadowStatus,
)
from autopilot.core.sensors import AID_SENSORS
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import FRD, NS, UINT32, clip, padded
from autopilot.log.packing.records import packer_of
from autopilot.log.schemas import layout

nav_covariance = packer_of(NavState, "NavCovariance", "ned")
nav_status = packer_of(
    NavState,
    "NavStatus",
    "ned",
    put={"doubts": lambda nav: sum(1 << bit for bit, doubt in enumerate(NavDoubt) if doubt in nav.doubts)},
)
shadow_status = packer_of(ShadowStatus, "ShadowStatus", "ned")
aid_status = packer_of(AidStatus, "AidStatus", "ned")
marker_fit = packer_of(MarkerFit, "MarkerFit", "frd")
_acting_thrust = layout("autopilot_msgs/ActingThrust").packer.pack
_nav_counters = layout("autopilot_msgs/NavCounters").packer.pack

_OF_THE_FILTER = (
    "resets",
    "clock.backwards",
    "thrust.malformed",
    "ahrs.good",
    "ahrs.malformed",
    "ahrs.future",
    "ahrs.old",
    "ahrs.stuck",
    "ahrs.blind_steps",
    "ahrs.tilt_disagreements",
)
_OF_AN_AID = ("received", "fused", "rejected", "late", "duplicate", "future", "malformed", "resets")
_OF_FRAMES = (
    "ok",
    "wrong_size",
    "wrong_type",
    "dark",
    "bright",
    "flat",
    "torn",
    "frozen",
    "dropped",
    "failed",
    "late",
    "foggy",
)
_OF_THE_REST = (
    "markers.unknown",
    "markers.misfit",
    "markers.leaning",
    "shadow.disagreements",
    "doubt.accel",
    "doubt.gyro",
    "doubt.compass_jumps",
    "doubt.jumps",
    "devices.sensors",
    "devices.camera",
    "devices.thrusters",
    "devices.watchdog",
    "power.malformed",
)
"""Names of counts, in the order of the fields of NavCounters; "" for places that are kept free."""


def _names() -> tuple[str, ...]:
    names = [*_OF_THE_FILTER]
    for what in _OF_AN_AID:
        names += [f"{sensor}.{what}" for sensor in AID_SENSORS] + [""] * (8 - len(AID_SENSORS))
    names += [f"frames.{what}" for what in _OF_FRAMES] + [""] * (16 - len(_OF_FRAMES))
    return (*names, *_OF_THE_REST)


COUNTER_NAMES = _names()
"""Of the values of NavCounters one by one, but for those of :data:`LAST_NAMES`."""
FIELD_DISTURBANCES = "ahrs.field_disturbances"
LAST_NAMES = ("faults", "other", FIELD_DISTURBANCES)
"""Behind them: all faults together, whatever has no place of its own, and what logs have not always had."""
_PLACED = frozenset((*COUNTER_NAMES, FIELD_DISTURBANCES))


def acting_thrust(stamp_ns: int, thrust_n: FloatArray) -> bytes:
    """ActingThrust."""
    return _acting_thrust(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, *padded(thrust_n, MAX_THRUSTERS))


def nav_counters(stamp_ns: int, value: NavCounters) -> bytes:
    """NavCounters; what was not counted is 0."""
    counts = [value.counts.get(name, 0) for name in COUNTER_NAMES]
    counts.append(sum(count for name, count in value.counts.items() if name.startswith("faults.")))
    placed = sum(count for name, count in value.counts.items() if name in _PLACED)
    counts.append(sum(value.counts.values()) - placed - counts[-1])
    counts.append(value.counts.get(FIELD_DISTURBANCES, 0))
    return _nav_counters(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, *(clip(count, UINT32) for count in counts))
