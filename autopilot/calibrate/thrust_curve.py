"""The curve of a thruster from a load cell: pulses, thrusts and supply voltages into the vehicle file's drive.

A table (CSV) has the columns ``pulse_us``, ``thrust_n`` and ``supply_v``, and ``thruster`` if it holds several; thrust
is positive where a longer pulse pushes. A brushed drive gets its three numbers by least squares, a drive with curves
gets monotonic ones (pool adjacent violators) with the dead band where nothing pushes.
"""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autopilot.calibrate.calibrate_tuning import THRUST_CURVE
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.thrusters import ThrustCurve, ThrusterDrive

COLUMNS = ("pulse_us", "thrust_n", "supply_v")


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    pulse_us: FloatArray
    thrust_n: FloatArray
    supply_v: FloatArray

    def __len__(self) -> int:
        return len(self.pulse_us)


@dataclass(frozen=True, slots=True, kw_only=True)
class BrushedFit:
    """F = c V |V| beyond the dead band."""

    deadband_duty: float
    forward_n_v2: float
    reverse_n_v2: float
    rms_n: float
    """Of what is left."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveFit:
    """Monotonic curves, one per voltage."""

    curves: tuple[ThrustCurve, ...]
    rms_n: float
    """Of what is left."""


def read_table(path: Path, thruster: str | None = None) -> Readings:
    """The rows of a table, of one thruster if it holds several. ConfigError names line and column."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = csv.DictReader(stream, skipinitialspace=True)
            heads, rows = table.fieldnames or (), [(table.line_num, row) for row in table]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{path}: cannot be read ({why}); give a table with {', '.join(COLUMNS)}") from error
    for name in COLUMNS:
        if heads.count(name) != 1:
            found = f"{heads.count(name)} columns" if name in heads else "no column"
            raise ConfigError(
                f"{path}: has {found} {name!r}; give a table with {', '.join(COLUMNS)}, commas between them"
            )
    named = sorted({row["thruster"] for _, row in rows if row.get("thruster")})
    if len(named) > 1 and thruster is None:
        raise ConfigError(f"{path}: holds {', '.join(named)}; say which with --thruster")
    if thruster is not None and named and thruster not in named:
        raise ConfigError(f"{path}: holds no thruster {thruster!r}; use one of {', '.join(named)}")
    values = [
        [_number(path, line, name, row[name]) for name in COLUMNS]
        for line, row in rows
        if thruster is None or not named or row.get("thruster") == thruster
    ]
    if len(values) < THRUST_CURVE.least_rows:
        raise ConfigError(
            f"{path}: {len(values)} readings are too few; give {THRUST_CURVE.least_rows} or more, both ways"
        )
    columns = np.array(values).T
    if not ((columns[2] > 0.0) & (columns[2] <= THRUST_CURVE.most_v)).all():
        raise ConfigError(
            f"{path}: `supply_v` must be above 0, at most {THRUST_CURVE.most_v:g}; give volts at the amplifier"
        )
    return Readings(*columns)


def _number(path: Path, line: int, name: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{path}: line {line}: `{name}` = {text!r} is not a number; correct or remove that line")
    return value


def fit_brushed(readings: Readings, drive: ThrusterDrive, origin: str) -> BrushedFit:
    """The three parameters of a brushed drive. ConfigError if the readings do not determine them."""
    duty = np.clip((readings.pulse_us - drive.neutral_us) / drive.span_us, -1.0, 1.0)
    moving = np.abs(readings.thrust_n) > THRUST_CURVE.still_fraction * float(np.abs(readings.thrust_n).max())
    _check_polarity(readings, moving, drive, origin)
    square = (duty * readings.supply_v) ** 2
    slope: dict[int, float] = {}
    for sign, name in ((1, "ahead"), (-1, "astern")):
        rows = moving & (np.sign(duty) == sign)
        if rows.sum() < 2:
            raise ConfigError(f"{origin}: {rows.sum()} readings {name} of neutral push; give 2 or more each way")
        slope[sign] = float((sign * readings.thrust_n[rows] * square[rows]).sum() / (square[rows] ** 2).sum())
    still = np.abs(duty[~moving])
    first = float(np.abs(duty[moving]).min())
    inside = still[still < first]
    deadband = 0.5 * (float(inside.max(initial=0.0)) + first)
    modelled = np.where(duty > 0.0, slope[1], -slope[-1]) * square * (np.abs(duty) > deadband)
    return BrushedFit(
        deadband_duty=round(deadband, 4),
        forward_n_v2=float(f"{slope[1]:.4g}"),
        reverse_n_v2=float(f"{slope[-1]:.4g}"),
        rms_n=_left_n(readings, readings.thrust_n - modelled, origin),
    )


def fit_curves(readings: Readings, drive: ThrusterDrive, origin: str) -> CurveFit:
    """One monotonic curve per supply voltage. ConfigError if the readings do not cover the drive's range."""
    curves, left = [], []
    order = np.argsort(readings.supply_v, kind="stable")
    breaks = (
        np.flatnonzero(np.diff(readings.supply_v[order]) > THRUST_CURVE.same_voltage * readings.supply_v[order][:-1])
        + 1
    )
    for rows in np.split(order, breaks):
        part = Readings(readings.pulse_us[rows], readings.thrust_n[rows], readings.supply_v[rows])
        supply_v = round(float(part.supply_v.mean()), 2)
        where = f"{origin}: {supply_v:g} V"
        moving = np.abs(part.thrust_n) > THRUST_CURVE.still_fraction * float(np.abs(part.thrust_n).max())
        _check_polarity(part, moving, drive, where)
        # One voltage's thrusts to its mean supply: they grow with its square.
        thrust = np.where(moving, part.thrust_n * (supply_v / part.supply_v) ** 2, 0.0)
        pulses, inverse = np.unique(np.round(part.pulse_us).astype(int), return_inverse=True)
        counts = np.bincount(inverse)
        level = _rising(np.bincount(inverse, thrust) / counts, counts)
        ahead = pulses > drive.neutral_us
        level = np.where(ahead, np.maximum(level, 0.0), np.minimum(level, 0.0)) * (pulses != drive.neutral_us)
        low_us, high_us = drive.neutral_us - drive.span_us, drive.neutral_us + drive.span_us
        if pulses[0] > low_us or pulses[-1] < high_us:
            raise ConfigError(f"{where}: pulses from {pulses[0]} to {pulses[-1]} us; measure {low_us} to {high_us}")
        left.append(part.thrust_n * (supply_v / part.supply_v) ** 2 - level[inverse])
        at = int(np.searchsorted(pulses, drive.neutral_us))
        if pulses[at] != drive.neutral_us:
            pulses, level = np.insert(pulses, at, drive.neutral_us), np.insert(level, at, 0.0)
        try:
            curves.append(
                ThrustCurve(
                    supply_v=supply_v,
                    pulse_us=tuple(pulses.tolist()),
                    thrust_n=tuple(round(value, 3) + 0.0 for value in level.tolist()),
                )
            )
        except ValueError as error:
            raise ConfigError(f"{where}: {error}; measure both ways") from error
    return CurveFit(curves=tuple(curves), rms_n=_left_n(readings, np.concatenate(left), origin))


def _left_n(readings: Readings, left_n: FloatArray, origin: str) -> float:
    """Root mean square of what is left of the thrusts. ConfigError if that is much of them."""
    rms_n, whole_n = (float(np.sqrt(np.mean(values**2))) for values in (left_n, readings.thrust_n))
    if rms_n > THRUST_CURVE.most_left * whole_n:
        raise ConfigError(
            f"{origin}: {rms_n:.2f} N rms are left of `thrust_n` with {whole_n:.2f} N rms: readings contradict each"
            " other; give those of one thruster, pulses in us, measured again where they differ"
        )
    return rms_n


def curves_text(curves: Sequence[ThrustCurve]) -> str:
    """The curves as tables of a vehicle file."""
    return "\n".join(
        f"[[drive.curve]]\nsupply_v = {curve.supply_v:g}\npulse_us = {list(curve.pulse_us)}\n"
        f"thrust_n = {list(curve.thrust_n)}\n"
        for curve in curves
    )


def _check_polarity(readings: Readings, moving: NDArray[np.bool_], drive: ThrusterDrive, origin: str) -> None:
    """ConfigError if most thrusts have the wrong sign: load cell or thruster is mounted in reverse."""
    sides = np.sign(readings.pulse_us - drive.neutral_us) * np.sign(readings.thrust_n) * moving
    if (sides < 0).sum() > (sides > 0).sum():
        raise ConfigError(
            f"{origin}: longer pulses push astern; turn the sign of `thrust_n`, or set `reversed` of the thruster"
        )


def _rising(values: FloatArray, weights: NDArray[np.integer[Any]]) -> FloatArray:
    """The nearest sequence (weighted least squares) that never falls: pool adjacent violators."""
    blocks: list[list[float]] = []  # mean, weight, length
    for value, weight in zip(values.tolist(), weights.tolist(), strict=True):
        blocks.append([value, float(weight), 1.0])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            mean, heavy, length = blocks.pop()
            last = blocks[-1]
            last[0] = (last[0] * last[1] + mean * heavy) / (last[1] + heavy)
            last[1] += heavy
            last[2] += length
    return np.concatenate([np.full(int(length), mean) for mean, _, length in blocks])
