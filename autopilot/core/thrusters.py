"""Thrusters of a vehicle: position, direction, drive and response. Any number from 3 to 8, in any order.

The only place where geometry becomes a matrix: :func:`wrench_matrix` (6 x N) for the plant, :func:`allocation` (4 x N)
for controller and estimator.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import msgspec

from autopilot.core.toml_table import Place3, Positive, Table, Vec3

MIN_THRUSTERS, MAX_THRUSTERS = 3, 8
MAX_CHANNEL = 16
"""Outputs of the amplifiers' boards."""

CONTROLLED = (0, 1, 2, 5)
"""Rows of a wrench that the controller steers: surge, sway, heave, yaw."""
_DIGITS = 12
"""Decimals of a matrix: cos(90 deg) is 0 and not 6e-17, which the optimiser would take for a way to push."""

PowerFactor = Annotated[float, msgspec.Meta(ge=1e-4, le=1e4)]
"""Watts per newton^1.5; small thrusters need about one."""

Row: TypeAlias = tuple[float, ...]


class ThrustCurve(Table, frozen=True, kw_only=True):
    """``[[drive.curve]]``: steady thrust over the pulse at one supply voltage, as a maker publishes it."""

    supply_v: Positive
    pulse_us: Annotated[tuple[int, ...], msgspec.Meta(min_length=4)]
    """Rising."""
    thrust_n: tuple[float, ...]
    """At these pulses: negative below neutral, 0 within the deadband, positive above; never falling."""

    def __post_init__(self) -> None:
        if len(self.pulse_us) != len(self.thrust_n):
            raise ValueError(f"{len(self.pulse_us)} of `pulse_us` and {len(self.thrust_n)} of `thrust_n`: one for each")
        for what, values in (("pulse_us", self.pulse_us), ("thrust_n", self.thrust_n)):
            for index, (one, other) in enumerate(itertools.pairwise(values), 1):
                if other < one or (what == "pulse_us" and other == one):
                    raise ValueError(f"`{what}[{index}]` = {other:g} after {one:g}: the curve is not monotonic")
        if not self.thrust_n[0] < 0.0 < self.thrust_n[-1]:
            raise ValueError("`thrust_n` begins below 0 and ends above 0: a thruster pushes both ways")


class ThrusterDrive(Table, frozen=True, kw_only=True):
    """Thruster and amplifier: thrust by pulse.

    ``brushed``: pulse -> duty -> voltage -> thrust F = c V |V|. ``curve``: the manufacturer's tables for ESC and
    brushless thruster together; linear between their voltages, quadratic in the voltage beyond them.
    """

    kind: Literal["brushed", "curve"] = "brushed"
    neutral_us: Annotated[int, msgspec.Meta(ge=500, le=2500)]
    span_us: Annotated[int, msgspec.Meta(gt=0, le=1000)]
    """Pulse difference between neutral and full duty."""
    deadband_duty: Annotated[float, msgspec.Meta(ge=0.0, lt=0.5)] | None = None
    """Brushed: duty up to which it does not turn."""
    forward_n_v2: Positive | None = None
    """Brushed: c ahead."""
    reverse_n_v2: Positive | None = None
    """Brushed: c astern."""
    curve: Annotated[tuple[ThrustCurve, ...], msgspec.Meta(max_length=16)] = ()
    nominal_supply_v: Positive
    time_constant_s: Annotated[float, msgspec.Meta(gt=0.0, le=5.0)]
    power_w_n15: PowerFactor
    """Electrical power P = this * |F|^1.5."""
    reverse_power_w_n15: PowerFactor | None = None
    """The same astern; absent = as ahead."""
    limit_n: Positive
    """Bound on every thrust command."""
    command_timeout_s: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
    """Outputs go to neutral when no command came for so long."""

    def __post_init__(self) -> None:
        law = {
            "deadband_duty": self.deadband_duty,
            "forward_n_v2": self.forward_n_v2,
            "reverse_n_v2": self.reverse_n_v2,
        }
        if self.kind == "brushed":
            missing = [name for name, value in law.items() if value is None]
            if missing or self.curve:
                raise ValueError(f'`kind` = "brushed" has {", ".join(law)} and no `curve`')
            return
        present = [name for name, value in law.items() if value is not None]
        if present or not self.curve:
            raise ValueError('`kind` = "curve" has tables `[[drive.curve]]` and none of ' + ", ".join(law))
        supplies = [curve.supply_v for curve in self.curve]
        if sorted(set(supplies)) != supplies:
            raise ValueError("`curve`: `supply_v` rises from table to table, no voltage twice")
        for curve in self.curve:
            self._check(curve)

    def _check(self, curve: ThrustCurve) -> None:
        """ValueError if a curve does not fit neutral and span."""
        low_us, high_us = self.neutral_us - self.span_us, self.neutral_us + self.span_us
        where = f"`curve` of {curve.supply_v:g} V"
        if curve.pulse_us[0] > low_us or curve.pulse_us[-1] < high_us:
            raise ValueError(f"{where}: `pulse_us` covers neutral -+ span, {low_us} to {high_us}")
        for pulse, thrust in zip(curve.pulse_us, curve.thrust_n, strict=True):
            if (pulse - self.neutral_us) * thrust < 0.0 or (pulse == self.neutral_us and thrust != 0.0):
                raise ValueError(f"{where}: {thrust:g} N at {pulse} us, neutral is {self.neutral_us}: wrong side")
        still = [pulse for pulse, thrust in zip(curve.pulse_us, curve.thrust_n, strict=True) if thrust == 0.0]
        if not still or not still[0] <= self.neutral_us <= still[-1]:
            raise ValueError(f"{where}: `thrust_n` is 0 round neutral, {self.neutral_us} us; give the deadband's ends")

    @property
    def brushed_law(self) -> tuple[float, float, float]:
        """Deadband as duty, c ahead and c astern [N/V^2] of a brushed drive."""
        if self.deadband_duty is None or self.forward_n_v2 is None or self.reverse_n_v2 is None:
            raise TypeError(f"a drive of kind {self.kind!r} has no brushed law")
        return self.deadband_duty, self.forward_n_v2, self.reverse_n_v2


class ThrusterTable(Table, frozen=True, kw_only=True):
    """``[[thruster]]``: where one thruster sits and where it pushes, as the autopilot is told."""

    name: str
    position_frd_m: Place3
    direction_frd: Vec3
    """Where it pushes the vehicle, of any length."""
    channel: Annotated[int, msgspec.Meta(ge=1, le=MAX_CHANNEL)] | None = None
    """Output of the amplifiers' board, from 1; absent = its place in the file."""
    reversed: bool = False
    """It turns the other way: a longer pulse pushes against ``direction_frd``."""
    limit_n: Positive | None = None
    """Bound on its thrust; absent = the drive's."""
    drive: ThrusterDrive | None = None
    """``[thruster.drive]``; absent = the file's ``[drive]``."""

    def __post_init__(self) -> None:
        if math.hypot(*self.direction_frd) == 0.0:
            raise ValueError("`direction_frd` = [0, 0, 0] has no direction; give a vector that is not zero")


@dataclass(frozen=True, slots=True, kw_only=True)
class Thruster:
    """One thruster with everything that its table leaves to the file's drive."""

    name: str
    position_frd_m: Vec3
    direction_frd: Vec3
    """Unit vector."""
    channel: int
    """From 1."""
    reversed: bool
    limit_n: float
    drive: ThrusterDrive


def thrusters_of(tables: Sequence[ThrusterTable], drive: ThrusterDrive) -> tuple[Thruster, ...]:
    """The thrusters of a file, in its order."""
    result = []
    for index, table in enumerate(tables):
        own = table.drive or drive
        x, y, z = table.direction_frd
        length = math.hypot(x, y, z)
        result.append(
            Thruster(
                name=table.name,
                position_frd_m=table.position_frd_m,
                direction_frd=(x / length, y / length, z / length),
                channel=index + 1 if table.channel is None else table.channel,
                reversed=table.reversed,
                limit_n=own.limit_n if table.limit_n is None else table.limit_n,
                drive=own,
            )
        )
    return tuple(result)


def wrench_matrix(positions_frd_m: Sequence[Vec3], directions_frd: Sequence[Vec3]) -> tuple[Row, ...]:
    """(6, N) force X, Y, Z and moment K, M, N about the origin of 1 N of each thruster: d and p x d."""
    columns = []
    for (px, py, pz), (dx, dy, dz) in zip(positions_frd_m, directions_frd, strict=True):
        columns.append((dx, dy, dz, py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx))
    # The sum makes 0 of -0.
    return tuple(tuple(round(column[i], _DIGITS) + 0.0 for column in columns) for i in range(6))


def allocation(thrusters: Sequence[Thruster]) -> tuple[Row, ...]:
    """(4, N) rows surge, sway, heave [N] and yaw [N m], columns the thrusters."""
    rows = wrench_matrix([t.position_frd_m for t in thrusters], [t.direction_frd for t in thrusters])
    return tuple(rows[i] for i in CONTROLLED)
