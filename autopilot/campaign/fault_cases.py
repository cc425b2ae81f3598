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


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultCase:
    """A fault that begins at a drawn time."""

    rule: Failsafe
    faults: tuple[Mapping[str, Any], ...] = ()
    """``[[fault]]`` tables; ``at_s`` in them counts from the drawn time."""
    params: Mapping[str, float] = field(default_factory=dict)
    """Flown with them."""
    set_then: Mapping[str, float] = field(default_factory=dict)
    """Parameters that the operator sets at the drawn time."""
    controller: str | None = None
    estimator: str | None = None
    """Flown instead of the shipped ones; they break at the drawn time."""
    effect: Effect
    within_s: float
    """From the drawn time to the bit."""
    settle_s: float = 15.0
    """From there to the end state that is evaluated."""


def _fault(kind: str, lasts_s: float | None = LASTING_S, at_s: float = 0.0, **keys: Any) -> Mapping[str, Any]:
    return {"kind": kind, "at_s": at_s, **({} if lasts_s is None else {"duration_s": lasts_s}), **keys}


BROKEN = "autopilot.campaign.fault_flights"

CASES: tuple[FaultCase, ...] = (
    FaultCase(
        rule=Failsafe.NAV_LOST,
        faults=(_fault("camera_blackout"), _fault("ahrs_freeze", at_s=1.0)),
        params={"FS_NAV_TIMEOUT": 2.0},
        effect="surface",
        within_s=12.0,
    ),
    FaultCase(
        rule=Failsafe.SOLVER,
        controller=f"{BROKEN}:Unsolved",
        params={"FS_SOLVER_ACT": 2},
        effect="surface",
        within_s=2.2,
    ),
    FaultCase(
        rule=Failsafe.BATTERY, faults=(_fault("battery_sag", None, remaining=0.08),), effect="surface", within_s=0.7
    ),
    FaultCase(rule=Failsafe.AHRS_STALE, faults=(_fault("ahrs_freeze"),), effect="surface", within_s=1.0),
    FaultCase(
        rule=Failsafe.THRUSTER,
        faults=(_fault("thruster_loss", None, thruster="starboard", loss=1.0),),
        effect="surface",
        within_s=25.0,
    ),
    FaultCase(
        rule=Failsafe.LATENCY,
        faults=(_fault("late_commands", latency_s=0.8),),
        effect="hold",
        within_s=15.0,
        settle_s=20.0,
    ),
    FaultCase(
        rule=Failsafe.NAV_CHECK,
        estimator=f"{BROKEN}:DisplacedEstimator",
        effect="warn",
        within_s=8.0,
    ),
    FaultCase(
        rule=Failsafe.FAULT,
        controller=f"{BROKEN}:Raising",
        effect="hold",
        within_s=0.1,
        settle_s=6.0,
    ),
    FaultCase(
        rule=Failsafe.GCS, faults=(_fault("link_loss"),), params={"FS_GCS_ENABLE": 4}, effect="surface", within_s=6.2
    ),
    FaultCase(
        rule=Failsafe.PILOT,
        faults=(_fault("pilot", 3.0, -3.0),),
        params={"FS_PILOT_INPUT": 3},
        effect="hold",
        within_s=3.3,
    ),
    FaultCase(
        rule=Failsafe.DEAD_RECKONING,
        faults=(_fault("camera_blackout", 5.0),),
        params={"FS_DR_TIME": 2.0, "FS_DR_ACT": 2},
        effect="surface",
        within_s=3.4,
    ),
    FaultCase(
        rule=Failsafe.SENSOR,
        faults=(_fault("sensor_silence", sensor="hull"),),
        params={"FS_SENS_ACT": 1},
        effect="hold",
        within_s=3.8,
    ),
    FaultCase(
        rule=Failsafe.DOUBT,
        faults=(_fault("markers_moved", offset_m=[0.2, 0.2, 0.0]),),
        params={"FS_DOUBT_ACT": 1},
        effect="hold",
        within_s=8.0,
    ),
    FaultCase(
        rule=Failsafe.BATTERY_CRITICAL,
        faults=(_fault("battery_sag", None, remaining=0.02),),
        params={"FS_BATT_ACT": 0},
        effect="surface",
        within_s=0.7,
    ),
    FaultCase(
        rule=Failsafe.ENERGY,
        faults=(_fault("battery_sag", None, remaining=0.45),),
        params={"FS_ENRG_RES": 0.5, "FS_ENRG_ACT": 3},
        effect="return",
        within_s=25.0,
    ),
    FaultCase(rule=Failsafe.LEAK, faults=(_fault("leak"),), params={"FS_LEAK_ENABLE": 3}, effect="drop", within_s=0.7),
    FaultCase(
        rule=Failsafe.PRESSURE,
        faults=(_fault("hull_climate", pressure_pa=120e3),),
        params={"FS_PRESS_ENABLE": 2},
        effect="surface",
        within_s=2.7,
    ),
    FaultCase(
        rule=Failsafe.TEMPERATURE,
        faults=(_fault("hull_climate", temperature_c=70.0),),
        params={"FS_TEMP_ENABLE": 2},
        effect="surface",
        within_s=2.7,
    ),
    FaultCase(
        rule=Failsafe.CAGE_SOFT,
        faults=(_fault("shove", 2.2, force_ned_n=[0.0, 0.0, 20.0]),),
        set_then={"DEPTH_MAX": 0.5, "FS_CAGE_HARD": 50.0, "LAT_DETECT": 0},  # a shove resembles late commands
        effect="warn",
        within_s=6.0,
    ),
    FaultCase(
        rule=Failsafe.CAGE_HARD,
        faults=(_fault("shove", 2.6, force_ned_n=[0.0, 0.0, 20.0]),),
        set_then={"DEPTH_MAX": 0.5, "FS_CAGE_HARD": 0.25},
        effect="surface",
        within_s=7.0,
    ),
    FaultCase(
        rule=Failsafe.TILT,
        faults=(_fault("shove", moment_frd_n_m=[3.0, 0.0, 0.0]),),
        params={"FS_CRASH_CHECK": 2},
        effect="disarm",
        within_s=5.0,
    ),
    FaultCase(
        rule=Failsafe.COLLISION,
        faults=(_fault("shove", 0.08, force_ned_n=[-60.0, 60.0, 0.0]),),
        params={"FS_COLL_ACT": 1},
        effect="hold",
        within_s=0.5,
    ),
    FaultCase(
        rule=Failsafe.STUCK,
        faults=(_fault("snag"),),
        params={"FS_STUCK_TIME": 4.0, "FS_STUCK_ACT": 1},
        effect="hold",
        within_s=25.0,
    ),
    FaultCase(rule=Failsafe.TETHER, set_then={"TETHER_LEN": 0.3, "TETHER_COUNT": 1}, effect="hold", within_s=0.3),
    FaultCase(
        rule=Failsafe.LOOP, faults=(_fault("slow_loop"),), params={"FS_LOOP_ACT": 1}, effect="hold", within_s=5.2
    ),
    FaultCase(
        rule=Failsafe.LOG, faults=(_fault("disk_full"),), params={"FS_LOG_ACT": 3}, effect="return", within_s=0.1
    ),
    FaultCase(
        rule=Failsafe.CLOCK,
        faults=(_fault("clock_jump", jump_s=3600.0),),
        params={"FS_CLOCK_ACT": 6},
        effect="hand back",
        within_s=0.1,
        settle_s=3.0,
    ),
    FaultCase(
        rule=Failsafe.ASCENT,
        faults=(_fault("ahrs_freeze"), _fault("camera_blackout")),
        params={"FS_ASCENT_TIME": 1.0, "FS_ASCENT_ACT": 4},
        effect="disarm",
        within_s=15.0,
    ),
    FaultCase(
        rule=Failsafe.WATCHDOG,
        faults=(_fault("watchdog_ended"),),
        params={"FS_WDOG_ACT": 2},
        effect="surface",
        within_s=3.2,
    ),
    FaultCase(
        rule=Failsafe.CAMERA,
        faults=(_fault("camera_near_frozen", 3.0),),
        effect="hold",
        within_s=12.0,
    ),
    FaultCase(rule=Failsafe.SENDER, faults=(_fault("second_sender"),), effect="hold", within_s=0.3),
)
