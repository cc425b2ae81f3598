"""Constants of thrust, thruster faults and latency, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ByHandTuning:
    """Constants of :mod:`autopilot.control.thrust.by_hand`."""

    yaw_gain_1_s: float = 1.2
    yaw_rate_gain_1_s: float = 3.0
    depth_gain_1_s: float = 0.6
    heave_gain_1_s: float = 2.0
    trim_gain_1_s2: float = 0.35
    """Cascades: error to rate, rate to acceleration; the trim takes up buoyancy that the vehicle file does not know."""
    yaw_rate_limit_rad_s: float = 0.4
    heave_limit_m_s: float = 0.15
    """Of the return to the held value."""
    trim_fraction: float = 0.5
    """Share of the vertical thrust that the trim may use."""
    depth_rate_s: float = 0.3
    """Time constant of the rate of depth."""
    slew_fraction_1_s: float = 4.5
    """Commands, the controller's as well, change by at most so many times the limit in force per second (of 12 N: 2.7 N
    from control step to control step; 0.44 s from full ahead to full astern, as the thrusters' own lag takes): a
    reference or a stick that jumps does not tear at the drive."""


BY_HAND = ByHandTuning()


@dataclass(frozen=True, slots=True)
class AttitudeStabilisationTuning:
    """Constants of :mod:`autopilot.control.thrust.attitude_stabilisation`."""

    most: float = 0.5
    """At most this share of a thruster's limit is kept for levelling."""
    small: float = 1e-6
    """Less than this of a newton per newton metre is rounding."""
    damping: float = 0.9
    """Of the critical one, for a tilt that swings freely. Half of it leaves 1.2 times the swing (rms) in the paper's
    tank, 1.4 times the largest ones, and reverses thrusters as often."""
    swing_gain: float = 0.3
    """Of a new rate in the mean by which it is damped, per tick: 0.03 s, a fifth of the thrusters' own lag."""
    least_lever_m: float = 0.03
    """Thrusters nearer to the centre of gravity swing it little, and would have to push hard."""
    least_fraction: float = 0.0125
    """... for less than this share of its limit (0.4 N of 34 N): it would run to and fro with the noise of rates and of
    the controller's thrust, several times a second, where two thrusters share a weight of 1 N."""


ATTITUDE_STABILISATION = AttitudeStabilisationTuning()


@dataclass(frozen=True, slots=True)
class WavesTuning:
    """Constants of :class:`autopilot.control.thrust.filtered_motion.Waves`."""

    rate_s: float = 0.3
    """Time constant of the rate of the current."""
    mean_s: float = 30.0
    """Of its mean square: several waves."""


WAVES = WavesTuning()


@dataclass(frozen=True, slots=True)
class LossBankTuning:
    """Constants of :mod:`autopilot.control.thrust.loss_bank`."""

    free: int = 1
    """The filter to which all thrusters are unknown."""
    each: int = 6
    """Stories per thruster, one half of half a thruster, the other of a dead one."""
    unseen: float = 1e6
    """Variance of an invalid axis."""


LOSS_BANK = LossBankTuning()


@dataclass(frozen=True, slots=True)
class DisturbanceLevelTuning:
    """Constants of :mod:`autopilot.control.thrust.actuation_delay`."""

    follow_s: float = 10.0
    """Time constant with which the level falls; it rises faster, the larger the innovations are."""
    most_ratio: float = 20.0
    """Squared innovation over its variance beyond which it counts no more: a collision is no sea."""
    silent: float = 2.5
    """Factor from which on evidence counts for nothing."""
    most: float = 1e3
    """Largest factor of the variance: 1.9 m/s^2 of surge."""


DISTURBANCE_LEVEL = DisturbanceLevelTuning()


@dataclass(frozen=True, slots=True)
class LossesTuning:
    """Constants of :mod:`autopilot.control.thrust.losses`."""

    report_every_us: int = 500_000
    """Twice per second: for the log, and to re-evaluate the capability."""
    submerged: float = 1.5
    """Depth in half heights of the hull above which heave is not used."""
    same_loss: float = 0.2
    """Tolerance within which a declared loss counts as the detected one."""


LOSSES = LossesTuning()


@dataclass(frozen=True, slots=True)
class ThrusterHealthTuning:
    """Constants of :mod:`autopilot.control.thrust.thruster_health`."""

    headings: int = 72
    """Headings tried for a hover; a multiple of four, so that abeam is exactly among them."""
    short_n: float = 0.3
    """Tolerated deficit: compensated by short pushes of the others."""
    dead: float = 0.2
    """Effectiveness below which a thruster is not used: little and uncertain thrust for five times the pulse."""
    settled_every: int = 10
    """Updates (1 s) between attempts to isolate a fault among redundant thrusters."""
    unlearned_updates: int = 10
    """Updates (1 s) that are reverted when the estimate degrades."""


THRUSTER_HEALTH = ThrusterHealthTuning()


@dataclass(frozen=True, slots=True)
class RedundancyTuning:
    """Constants of :mod:`autopilot.control.thrust.redundancy`."""

    alike: float = 0.2
    """Columns with a smaller relative difference are redundant: 11 degrees."""
    kept_updates: int = 400
    """40 s."""
    independent_s: float = 1.5
    """Looks so far apart share no noise: roll and pitch swing."""
    same_arm: float = 1e-3
    """Smallest usable difference of arms [rad/s^2 per N]."""
    first_noise: float = 0.1
    least_noise: float = 0.03
    """Of the tilt's acceleration [rad/s^2]: guessed before the fit, and at the least after it."""


REDUNDANCY = RedundancyTuning()
