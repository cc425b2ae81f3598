"""One fault scenario for every row of the failsafe table: fault injected, and response required.

Data only; :mod:`autopilot.campaign.fault_flights` flies it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from autopilot.command.failsafe_table import Effect
from autopilot.core.messages import Failsafe

LASTING_S = 600.0
"""To the end of every flight."""
NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class FaultCase:
    """A fault that begins at a drawn time."""

    rule: Failsafe
    effect: Effect
    within_s: float
    """From the drawn time to the bit."""
    faults: tuple[Mapping[str, Any], ...] = ()
    """``[[fault]]`` tables; ``at_s`` in them counts from the drawn time."""
    params: Mapping[str, float] = field(default_factory=dict)
    """Flown with them."""
    set_then: Mapping[str, float] = field(default_factory=dict)
    """Parameters that the operator sets at the drawn time."""
    controller: str | None = None
    estimator: str | None = None
    """Flown instead of the shipped ones; they break at the drawn time."""
    settle_s: float = 15.0
    """From there to the end state that is evaluated."""


def _fault(kind: str, lasts_s: float | None = LASTING_S, at_s: float = 0.0, **keys: Any) -> tuple[Mapping[str, Any]]:
    """:attr:`FaultCase.faults` with one fault."""
    return ({"kind": kind, "at_s": at_s, **({} if lasts_s is None else {"duration_s": lasts_s}), **keys},)


BROKEN = "autopilot.campaign.fault_flights"

CASES: tuple[FaultCase, ...] = (
    FaultCase(
        Failsafe.NAV_LOST,
        "surface",
        12.0,
        _fault("camera_blackout") + _fault("ahrs_freeze", at_s=1.0),
        {"FS_NAV_TIMEOUT": 2.0},
    ),
    FaultCase(Failsafe.SOLVER, "surface", 2.2, params={"FS_SOLVER_ACT": 2}, controller=f"{BROKEN}:Unsolved"),
    FaultCase(Failsafe.BATTERY, "surface", 0.7, _fault("battery_sag", None, remaining=0.08)),
    FaultCase(Failsafe.AHRS_STALE, "surface", 1.0, _fault("ahrs_freeze")),
    FaultCase(Failsafe.THRUSTER, "surface", 25.0, _fault("thruster_loss", None, thruster="starboard", loss=1.0)),
    FaultCase(Failsafe.LATENCY, "hold", 15.0, _fault("late_commands", latency_s=0.8), settle_s=20.0),
    FaultCase(Failsafe.NAV_CHECK, "warn", 8.0, estimator=f"{BROKEN}:DisplacedEstimator"),
    FaultCase(Failsafe.FAULT, "hold", 0.1, controller=f"{BROKEN}:Raising", settle_s=6.0),
    FaultCase(Failsafe.GCS, "surface", 6.2, _fault("link_loss"), {"FS_GCS_ENABLE": 4}),
    FaultCase(Failsafe.PILOT, "hold", 3.3, _fault("pilot", 3.0, -3.0), {"FS_PILOT_INPUT": 3}),
    FaultCase(
        Failsafe.DEAD_RECKONING, "surface", 3.4, _fault("camera_blackout", 5.0), {"FS_DR_TIME": 2.0, "FS_DR_ACT": 2}
    ),
    FaultCase(Failsafe.SENSOR, "hold", 3.8, _fault("sensor_silence", sensor="hull"), {"FS_SENS_ACT": 1}),
    FaultCase(Failsafe.DOUBT, "hold", 8.0, _fault("markers_moved", offset_m=[0.2, 0.2, 0.0]), {"FS_DOUBT_ACT": 1}),
    FaultCase(
        Failsafe.BATTERY_CRITICAL, "surface", 0.7, _fault("battery_sag", None, remaining=0.02), {"FS_BATT_ACT": 0}
    ),
    FaultCase(
        Failsafe.ENERGY,
        "return",
        25.0,
        _fault("battery_sag", None, remaining=0.45),
        {"FS_ENRG_RES": 0.5, "FS_ENRG_ACT": 3},
    ),
    FaultCase(Failsafe.LEAK, "drop", 0.7, _fault("leak"), {"FS_LEAK_ENABLE": 3}),
    FaultCase(Failsafe.PRESSURE, "surface", 2.7, _fault("hull_climate", pressure_pa=120e3), {"FS_PRESS_ENABLE": 2}),
    FaultCase(Failsafe.TEMPERATURE, "surface", 2.7, _fault("hull_climate", temperature_c=70.0), {"FS_TEMP_ENABLE": 2}),
    FaultCase(
        Failsafe.CAGE_SOFT,
        "warn",
        6.0,
        _fault("shove", 2.2, force_ned_n=[0.0, 0.0, 20.0]),
        set_then={"DEPTH_MAX": 0.5, "FS_CAGE_HARD": 50.0, "LAT_DETECT": 0},  # a shove resembles late commands
    ),
    FaultCase(
        Failsafe.CAGE_HARD,
        "surface",
        7.0,
        _fault("shove", 2.6, force_ned_n=[0.0, 0.0, 20.0]),
        set_then={"DEPTH_MAX": 0.5, "FS_CAGE_HARD": 0.25},
    ),
    FaultCase(Failsafe.TILT, "disarm", 5.0, _fault("shove", moment_frd_n_m=[3.0, 0.0, 0.0]), {"FS_CRASH_CHECK": 2}),
    FaultCase(
        Failsafe.COLLISION, "hold", 0.5, _fault("shove", 0.08, force_ned_n=[-60.0, 60.0, 0.0]), {"FS_COLL_ACT": 1}
    ),
    FaultCase(Failsafe.STUCK, "hold", 25.0, _fault("snag"), {"FS_STUCK_TIME": 4.0, "FS_STUCK_ACT": 1}),
    FaultCase(Failsafe.TETHER, "hold", 0.3, set_then={"TETHER_LEN": 0.3, "TETHER_COUNT": 1}),
    FaultCase(Failsafe.LOOP, "hold", 5.2, _fault("slow_loop"), {"FS_LOOP_ACT": 1}),
    FaultCase(Failsafe.LOG, "return", 0.1, _fault("disk_full"), {"FS_LOG_ACT": 3}),
    FaultCase(Failsafe.CLOCK, "hand back", 0.1, _fault("clock_jump", jump_s=3600.0), {"FS_CLOCK_ACT": 6}, settle_s=3.0),
    FaultCase(
        Failsafe.ASCENT,
        "disarm",
        15.0,
        _fault("ahrs_freeze") + _fault("camera_blackout"),
        {"FS_ASCENT_TIME": 1.0, "FS_ASCENT_ACT": 4},
    ),
    FaultCase(Failsafe.WATCHDOG, "surface", 3.2, _fault("watchdog_ended"), {"FS_WDOG_ACT": 2}),
    FaultCase(Failsafe.CAMERA, "hold", 12.0, _fault("camera_near_frozen", 3.0)),
    FaultCase(Failsafe.SENDER, "hold", 0.3, _fault("second_sender")),
)
