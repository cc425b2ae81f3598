"""Inverse of ArduSub's mixer: RC channels for the wanted motor outputs.

In MANUAL every axis is a channel, every motor the sum of its axes: pulse = 1500 + MOT_n_DIRECTION * sum, linear, in
whole microseconds. A frame of six or eight motors has fewer axes than motors: not every combination of pulses is
attainable, and our allocation, which uses the thruster curves, requests such combinations (a thruster is weaker
astern). Force and moment then have priority: the channels reproduce them, as close as possible to the requested
pulses.

A positive sum pushes as in the frame's table, however motor and propeller are mounted: on a vehicle that its pilot can
fly, MOT_n_DIRECTION is set accordingly. The vehicle file gives the direction of thrust for a longer pulse; thruster n
of the file (``channel``) is motor n.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.thrust_law import ThrustLaw, laws_of
from autopilot.core.thrusters import wrench_matrix
from autopilot.core.vehicle import Vehicle

NEUTRAL_US, SPAN_US = 1500, 400


class Axis(IntEnum):
    """RC channels, counted from 0."""

    PITCH = 0
    ROLL = 1
    THROTTLE = 2
    YAW = 3
    FORWARD = 4
    LATERAL = 5


CHANNELS = len(Axis)

FLAT = (Axis.FORWARD, Axis.LATERAL, Axis.YAW)
_FLAT_FACTORS = ((-1, 1, 1), (-1, -1, -1), (1, 1, -1), (1, -1, 1))
PLANE_MOTORS = len(_FLAT_FACTORS)
"""The first so many motors lie in the plane; the others stand upright."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArduSubFrame:
    """One of ArduSub's frames (FRAME_CONFIG)."""

    name: str
    number: int
    upright: tuple[Axis, ...]
    upright_factors: tuple[tuple[int, ...], ...]
    """Of the motors from the fifth on."""

    @property
    def motors(self) -> int:
        return len(_FLAT_FACTORS) + len(self.upright_factors)


FRAMES = {
    "vectored": ArduSubFrame(
        name="vectored",
        number=1,
        upright=(Axis.THROTTLE, Axis.ROLL),
        upright_factors=((-1, 1), (-1, -1)),
    ),
    "vectored_6dof": ArduSubFrame(
        name="vectored_6dof",
        number=2,
        upright=(Axis.THROTTLE, Axis.ROLL, Axis.PITCH),
        upright_factors=((-1, 1, -1), (-1, -1, -1), (-1, 1, 1), (-1, -1, 1)),
    ),
}

WRENCH_ROWS = {
    Axis.FORWARD: 0,
    Axis.LATERAL: 1,
    Axis.THROTTLE: 2,
    Axis.ROLL: 3,
    Axis.PITCH: 4,
    Axis.YAW: 5,
}
"""Which force or moment an axis is for."""

PULLS = 1e-4
"""How much a newton that is missing counts against a microsecond off: (N/us)^2. A thruster gives about 0.1 N/us."""
TURNS = 8
"""Steps of the search; it ends with the first that changes nothing: channels are whole microseconds."""
NEAR_US = 0.5
SLOPE_US = 10
"""A curve's slope is taken over so many microseconds to either side, or it would be 0 in the whole dead band."""


class Group:
    """Motors that share axes: the four in the plane, or those that stand upright."""

    def __init__(
        self, axes: Sequence[Axis], factors: FloatArray, wrench: FloatArray, laws: Sequence[ThrustLaw], place: slice
    ) -> None:
        """``factors`` (m, axes) push along the file's directions; ``wrench`` (axes, m) of 1 N of each motor."""
        self.axes = tuple(axes)
        self.factors = factors
        self.place = place
        self._laws = tuple(laws)
        self._curves: tuple[float | None, list[list[float]]] | None = None
        """Supply voltage of the last question; each motor's thrust there, from SLOPE_US below the span to above it."""
        size = np.abs(wrench).sum(axis=1) / 2.0
        if not (size > 0.0).all():
            missing = self.axes[int(np.argmin(size))].name.lower()
            raise ConfigError(f"the vehicle file's thrusters make nothing of the axis {missing}; correct their places")
        self._wrench = wrench / size[:, None]
        self._start = np.linalg.pinv(factors)
        self._pull = PULLS * factors.T
        self._pulls = self._pull @ factors

    def channels_us(self, wanted_us: FloatArray, supply_v: float | None) -> FloatArray:
        """(axes,) offsets from neutral for offsets (m,) of the pulses, both ahead positive."""
        offset_us: FloatArray = self._start @ wanted_us
        reached_us = self.factors @ offset_us
        missing_us = wanted_us - reached_us
        if float(np.abs(missing_us).max()) < NEAR_US:
            return offset_us
        curves = self._curves_at(supply_v)
        aim = self._wrench @ _thrust_and_slope(curves, wanted_us)[0]
        for _ in range(TURNS):
            thrust, slope = _thrust_and_slope(curves, reached_us)
            lever = (self._wrench * slope) @ self.factors
            step = np.linalg.solve(
                lever.T @ lever + self._pulls, lever.T @ (aim - self._wrench @ thrust) + self._pull @ missing_us
            )
            offset_us = offset_us + step
            if float(np.abs(step).max()) < NEAR_US:
                break
            reached_us = self.factors @ offset_us
            missing_us = wanted_us - reached_us
        return offset_us

    def _curves_at(self, supply_v: float | None) -> list[list[float]]:
        if self._curves is None or self._curves[0] != supply_v:
            curves: dict[ThrustLaw, list[float]] = {}
            for law in dict.fromkeys(self._laws):
                table = law.thrusts_n(supply_v)
                curves[law] = [table[0]] * SLOPE_US + [*table] + [table[-1]] * SLOPE_US
            self._curves = supply_v, [curves[law] for law in self._laws]
        return self._curves[1]


def _thrust_and_slope(curves: Sequence[Sequence[float]], offsets_us: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m,) thrust [N] and its slope [N/us] of each motor at its offset (m,)."""
    places = [min(max(round(us), -SPAN_US), SPAN_US) + SPAN_US + SLOPE_US for us in offsets_us.tolist()]
    thrust = [curve[place] for curve, place in zip(curves, places, strict=True)]
    rise = [curve[place + SLOPE_US] - curve[place - SLOPE_US] for curve, place in zip(curves, places, strict=True)]
    return np.array(thrust), np.array(rise) / (2.0 * SLOPE_US)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mixed:
    """Channels to send and the expected servo outputs [us]."""

    channels_us: tuple[int, ...]
    """Pulses of the channels 1 to 6."""
    servos_us: tuple[int, ...]
    """Pulses of the motors 1 to n."""


class Mixer:
    """Pulses per thruster in the order of the vehicle file, channels out."""

    def __init__(self, vehicle: Vehicle, frame: ArduSubFrame) -> None:
        """ConfigError if the vehicle's thrusters are not that frame's."""
        thrusters = sorted(vehicle.thrusters, key=lambda thruster: thruster.channel)
        self._order = [vehicle.thrusters.index(thruster) for thruster in thrusters]
        if [thruster.channel for thruster in thrusters] != list(range(1, frame.motors + 1)):
            raise ConfigError(
                f"vehicle {vehicle.name!r}: ArduSub's frame {frame.name} has motors 1 to {frame.motors}; give as many"
                " thrusters, the `channel` of each its motor"
            )
        for thruster in thrusters:
            if (thruster.drive.neutral_us, thruster.drive.span_us) != (NEUTRAL_US, SPAN_US):
                raise ConfigError(
                    f"vehicle {vehicle.name!r}: ArduSub's pulses are {NEUTRAL_US} +- {SPAN_US} us; set `neutral_us` and"
                    f" `span_us` of {thruster.name!r} so"
                )
        wrench = np.array(wrench_matrix([t.position_frd_m for t in thrusters], [t.direction_frd for t in thrusters]))
        laws = laws_of(thrusters)
        factors = np.zeros((frame.motors, CHANNELS))
        flat = len(_FLAT_FACTORS)
        factors[:flat, FLAT] = _FLAT_FACTORS
        factors[flat:, frame.upright] = frame.upright_factors
        self._factors = factors
        """(motors, channels) as in the frame's table."""
        self._sides = _sides(factors, wrench, [thruster.name for thruster in thrusters], frame)
        self._turned = np.array([-1 if thruster.reversed else 1 for thruster in thrusters])
        ours = factors * self._sides[:, None]
        self._groups = [
            Group(
                axes, ours[place][:, axes], wrench[[WRENCH_ROWS[axis] for axis in axes]][:, place], laws[place], place
            )
            for axes, place in ((FLAT, slice(0, flat)), (frame.upright, slice(flat, frame.motors)))
        ]
        self.directions = np.ones(frame.motors)
        """MOT_n_DIRECTION."""
        self.yaw_gain = 1.0
        """Yaw goes through ACRO_YAW_P / 3.375."""

    @property
    def motors(self) -> int:
        return len(self._order)

    @property
    def heave_signs(self) -> tuple[float, ...]:
        """Of the upright motors' pulses."""
        return tuple((self.directions * self._factors[:, Axis.THROTTLE])[PLANE_MOTORS:].tolist())

    def take(self, parameters: Mapping[str, float]) -> None:
        """Use the flight controller's mixing parameters."""
        names = [f"MOT_{motor}_DIRECTION" for motor in range(1, self.motors + 1)]
        self.directions = np.array([-1.0 if parameters.get(name, 1.0) < 0.0 else 1.0 for name in names])
        self.yaw_gain = parameters.get("ACRO_YAW_P", DEFAULT_YAW_P) / DEFAULT_YAW_P

    def mix(self, pwm_us: Sequence[int], supply_v: float | None) -> Mixed:
        """Channels for a pulse per thruster, in the order of the vehicle file."""
        wanted_us = self._turned * (np.array([pwm_us[index] for index in self._order], dtype=float) - NEUTRAL_US)
        offsets = np.zeros(CHANNELS)
        for group in self._groups:
            wanted = wanted_us[group.place]
            if not wanted.any():
                continue
            found = group.channels_us(wanted, supply_v)
            most = max(float(np.abs(group.factors @ found).max()), float(np.abs(found).max()))
            if most > SPAN_US:  # the direction of the force is kept, not its size
                found = found * (SPAN_US / most)
            offsets[list(group.axes)] = found
        offsets[Axis.YAW] /= self.yaw_gain
        whole = np.clip(np.round(offsets), -SPAN_US, SPAN_US)
        channels_us = tuple(int(NEUTRAL_US + offset) for offset in whole)
        return Mixed(channels_us=channels_us, servos_us=self._servos_us(whole))

    def pulses_us(self, servos_us: Sequence[int]) -> tuple[int, ...]:
        """A pulse per thruster, in the order of the vehicle file, from those of the motors 1 to n: mixing backwards."""
        off_us = np.array([servo - NEUTRAL_US if servo else 0 for servo in servos_us], dtype=float)  # 0: no pulse yet
        offsets = self._turned * self._sides * self.directions * off_us
        pulses = [NEUTRAL_US] * self.motors
        for index, offset in zip(self._order, offsets.tolist(), strict=True):
            pulses[index] = round(NEUTRAL_US + offset)
        return tuple(pulses)

    def _servos_us(self, channels: FloatArray) -> tuple[int, ...]:
        acting = channels.copy()
        acting[Axis.YAW] *= self.yaw_gain
        sums = np.clip(self._factors @ acting, -SPAN_US, SPAN_US)
        return tuple(round(NEUTRAL_US + offset) for offset in (self.directions * sums).tolist())


DEFAULT_YAW_P = 3.375
NEUTRAL = (NEUTRAL_US,) * CHANNELS
"""What stops all motors."""


def _sides(factors: FloatArray, wrench: FloatArray, names: Sequence[str], frame: ArduSubFrame) -> FloatArray:
    """(motors,) 1 where a positive sum pushes along the file's direction, -1 where against it."""
    pushes = factors[:, Axis.FORWARD, None] * [1.0, 0.0, 0.0] + factors[:, Axis.LATERAL, None] * [0.0, 1.0, 0.0]
    pushes = pushes - factors[:, Axis.THROTTLE, None] * [0.0, 0.0, 1.0]  # the throttle's positive side is up
    along = (pushes * wrench[:3].T).sum(axis=1) / np.linalg.norm(pushes, axis=1)
    for motor, (name, cosine) in enumerate(zip(names, along.tolist(), strict=True), 1):
        if abs(cosine) < 0.7:
            raise ConfigError(
                f"thruster {name!r} does not push along motor {motor} of ArduSub's frame {frame.name}; correct its"
                " `direction_frd` or `channel`"
            )
    return np.asarray(np.sign(along), dtype=np.float64)
