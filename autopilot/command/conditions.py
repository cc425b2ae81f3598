"""Facts of a tick that failsafes and arming go by."""

from dataclasses import dataclass, field

from autopilot.command.facts import VehicleStatus
from autopilot.core.messages import Below, NavDoubt, NavHealth, NavState
from autopilot.core.samples import PowerSample
from autopilot.mavlink.api import Sticks


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TickInputs:
    """Facts of this tick that rules and arming look at."""

    t_us: int
    nav: NavState | None
    power: PowerSample | None
    ahrs_age_s: float | None
    """Since the last good sample (a frozen device sends none); None = nothing heard yet."""
    solver_failures: int
    """NMPC steps in a row without a solution."""
    unreachable: bool = False
    """The controller finds no way to its goal."""
    way_left_m: float | None = None
    """Length of the way to the goal as the controller flies it, None = it has none."""
    nav_doubts: frozenset[NavDoubt] = frozenset()
    """What speaks against the estimate or its sensors."""
    nav_disagrees: bool = False
    """The estimator in the shadow of the flown one has been somewhere else for a while."""
    thruster_share: tuple[float, ...] = ()
    """What each thruster gives of its thrust, in the order of the vehicle file; empty = not known."""
    thrusters_doubtful: tuple[tuple[str, ...], ...] = ()
    """Those that do the same of which one is weak, nobody knows which: each has its part of what they give."""
    thruster_problem: str = ""
    """What the thrusters that are left cannot do any more."""
    watchdog_problem: str = ""
    """What is wrong with the process that stops the thrusters when the service cannot."""
    thrusters_unseen: tuple[str, ...] = ()
    """Those of which nobody would know had they lost half of their thrust."""
    command_delay_s: float = 0.0
    """So late commands reach the thrusters, beyond doubt."""
    fault: str = ""
    """What has failed inside the service of late."""
    below: Below | None = None
    """The flight controller below us, None without one."""
    refusals: tuple[str, ...] = ()
    """What devices have against arming."""
    sticks: Sticks | None = None
    """Of the pilot, None = nobody steers (any more)."""
    facts: VehicleStatus = field(default_factory=VehicleStatus)
    """What has been heard beside the estimate."""

    @property
    def estimate(self) -> NavState | None:
        """The estimate, None when there is none or it is lost."""
        return None if self.nav is None or self.nav.health is NavHealth.INVALID else self.nav
