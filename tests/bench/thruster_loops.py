"""Random vehicles in random waters against the detector of lost thrusters, in a loop that costs next to nothing.

The vehicle is the simulated plant, drawn far from the vehicle file: drag and thrust constant by up to 30 %, masses by
20 %, lever arms, places of the thrusters, lag, deadband, buoyancy, tether. The water is still, uniform, a jet, gyres, a
vortex or a shear. A pilot flies from waypoint to waypoint, sometimes onto the surface or against a wall; tugs come and
go. The estimate is what an estimator makes of it: small errors of the velocity that last, and a current that explains
what the model does not. All of it follows from one seed.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from autopilot.control.thrust.allocation import Allocation
from autopilot.control.thrust.thrust_tuning import LOSSES
from autopilot.control.thrust.thruster_health import ThrusterHealth, usable
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import Model4, body_acceleration
from autopilot.core.response import Response
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.sitl.current_fields import Gyre, NoCurrentTable, Shear, TankJet, Uniform, Vortex, current_field
from autopilot.sitl.plant import Plant, Truth
from autopilot.sitl.scenario_tables import ThrusterLoss
from autopilot.sitl.simulated_waters import SimulatedWaters

STEP_US = 20_000
"""Of the loop."""

WALLS_M = ((-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0))
FLOOR_M = 2.0
HAND_S = 1.0
"""The pilot begins after this time."""


THRUSTERS = 4
"""Of the vehicle of these flights."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    thruster: int
    share: float
    """That is left."""
    at_s: float


@dataclass(slots=True)
class Flown:
    """What the detector said of one flight."""

    first_s: float | None = None
    """First word of the thruster that was lost, after it was."""
    false: list[tuple[float, str, float]] = field(default_factory=list)
    """Time [s], thruster and share of every other word."""
    seen_s: list[float | None] = field(default_factory=lambda: [None] * THRUSTERS)
    """Since when half of each thruster would be seen."""
    peak: float = 0.0
    """Most evidence against a thruster that was sound [nats]."""
    found: tuple[float, ...] = (1.0,) * THRUSTERS
    """At the end."""


def drawn_vehicle(rng: np.random.Generator, vehicle: Vehicle, spread: float = 0.3) -> tuple[Vehicle, dict[str, float]]:
    """A vehicle with thrusters elsewhere, and the factors by which the plant differs."""

    def about(width: float) -> float:
        return float(rng.uniform(1.0 - width, 1.0 + width))

    mismatch = {key: about(min(spread, 0.2)) for key in ("surge_mass", "sway_mass", "heave_mass", "yaw_inertia")}
    mismatch |= {key: about(spread) for key in ("surge_drag", "sway_drag", "heave_drag", "yaw_drag", "thrust")}
    mismatch |= {"arm": about(0.1), "buoyancy": about(0.01), "lag": about(0.5), "deadband": about(0.2)}
    mismatch["tether_pull"] = float(rng.uniform(0.0, 5.0))
    mismatch["supply"] = float(rng.uniform(0.9, 1.0))
    thrusters = []
    for thruster in vehicle.thruster_tables:
        x, y, z = thruster.position_frd_m
        dx, dy = rng.uniform(-0.01, 0.01, 2)
        if thruster.name == "lateral":
            dx *= 3.0
        thrusters.append(msgspec.structs.replace(thruster, position_frd_m=(x + dx, y + dy, z)))
    return msgspec.structs.replace(vehicle, thruster_tables=tuple(thrusters)), mismatch


def drawn_current(rng: np.random.Generator) -> Any:
    speed, heading = float(rng.uniform(0.05, 0.35)), float(rng.uniform(-math.pi, math.pi))
    place = (float(rng.uniform(-1.0, 1.0)), float(rng.uniform(-1.0, 1.0)))
    tables = (
        NoCurrentTable(),
        Uniform(velocity_m_s=(speed * math.cos(heading), speed * math.sin(heading), 0.0)),
        Uniform(
            velocity_m_s=(0.5 * speed * math.cos(heading), 0.5 * speed * math.sin(heading), 0.0),
            tide_m_s=(0.5 * speed, 0.0, 0.0),
            tide_period_s=float(rng.uniform(8.0, 40.0)),
        ),
        TankJet(speed_m_s=speed, center_m=place, length_m=8.0, width_m=float(rng.uniform(3.0, 8.0))),
        Gyre(speed_m_s=speed, cell_m=float(rng.uniform(2.5, 6.0))),
        Vortex(center_m=place, circulation_m2_s=4.0 * speed, core_m=float(rng.uniform(0.6, 1.5))),
        Shear(speed_m_s=0.3 * speed, shear_1_s=float(rng.uniform(-0.15, 0.15))),
    )
    return current_field(tables[int(rng.integers(len(tables)))])


class _Pilot:
    """From waypoint to waypoint: velocity over ground, then drag feed-forward and velocity feedback on the model."""

    def __init__(self, rng: np.random.Generator, model: Model4) -> None:
        self._rng = rng
        self._model = model
        self._allocator = ControlAllocator(model)
        self._until_s = 0.0
        self._target = np.zeros(4)
        self._speed = 0.3
        self._wild = float(rng.uniform(0.0, 1.0)) < 0.3
        """Goes to the surface and against walls."""

    def thrust(self, t_s: float, nav: NavState) -> FloatArray:
        """(4,) [N]."""
        if t_s >= self._until_s:
            self._choose(t_s)
        model, c, s = self._model, math.cos(nav.rpy_rad[2]), math.sin(nav.rpy_rad[2])
        error = self._target[:3] - nav.pos_ned_m
        distance = math.hypot(error[0], error[1])
        speed = min(0.5 * distance, self._speed) / max(distance, 1e-6)
        north, east = speed * error[0] - nav.current_ned_m_s[0], speed * error[1] - nav.current_ned_m_s[1]
        shrink = min(1.0, 0.5 / max(math.hypot(north, east), 1e-9))
        north, east = shrink * north, shrink * east
        turn = max(-0.6, min(0.6, 0.8 * wrap_pi(float(self._target[3] - nav.rpy_rad[2]))))
        climb = max(-0.12, min(0.12, 0.5 * float(error[2])))
        wanted = (c * north + s * east, c * east - s * north, climb, turn)
        now = (*(float(v) for v in nav.vel_water_frd_m_s), float(nav.rate_frd_rad_s[2]))
        drift = body_acceleration(model, wanted, (0.0,) * model.thrusters, math)
        force = [m * (1.5 * (w - v) - a) for m, w, v, a in zip(model.mass_kg, wanted, now, drift, strict=True)]
        return self._allocator.thrust_n(np.array(force), np.full(model.thrusters, 11.0))

    def _choose(self, t_s: float) -> None:
        rng = self._rng
        self._until_s = t_s + float(rng.uniform(4.0, 14.0))
        north, east, yaw = rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0), rng.uniform(-math.pi, math.pi)
        depth = rng.uniform(0.35, 1.2)
        if self._wild and rng.uniform() < 0.25:
            depth = 0.05
        elif self._wild and rng.uniform() < 0.25:
            north = 4.2
        if rng.uniform() < 0.3:
            yaw = self._target[3]
        self._target = np.array([north, east, depth, yaw])
        self._speed = float(rng.uniform(0.1, 0.45))


class _Estimator:
    """Truth with errors that last, and a current that explains what the model does not."""

    def __init__(self, rng: np.random.Generator, model: Model4) -> None:
        self._rng = rng
        self._model = model
        self._error = np.zeros(4)
        self._yaw_error = float(rng.normal(0.0, 0.03))
        self._flow_gain = float(rng.uniform(0.2, 0.8))
        self._through: FloatArray | None = None
        self.current: FloatArray = np.zeros(3)

    def nav(self, truth: Truth, thrust_n: FloatArray, dt_s: float) -> NavState:
        """The estimate; ``thrust_n`` (4,) is what it believes to act."""
        rng = self._rng
        keep = math.exp(-dt_s / 0.6)
        self._error = keep * self._error + math.sqrt(1.0 - keep * keep) * rng.normal(0.0, 1.0, 4) * [
            *(0.005, 0.005, 0.004),
            0.004,
        ]
        vel = truth.vel_frd_m_s + self._error[:3]
        rate = np.array([0.0, 0.0, truth.rate_frd_rad_s[2] + self._error[3] + rng.normal(0.0, 0.002)])
        yaw = wrap_pi(float(truth.rpy_rad[2]) + self._yaw_error)
        self._follow(vel, rate[2], yaw, thrust_n, dt_s)
        c, s = math.cos(yaw), math.sin(yaw)
        north, east, _ = self.current
        flow = np.array([c * north + s * east, c * east - s * north, 0.0])
        return NavState(
            t_us=truth.t_us,
            health=NavHealth.GOOD,
            pos_ned_m=truth.pos_ned_m + rng.normal(0.0, 0.003, 3),
            rpy_rad=np.array([0.0, 0.0, yaw]),
            vel_frd_m_s=vel,
            vel_water_frd_m_s=vel - flow,
            rate_frd_rad_s=rate,
            current_ned_m_s=self.current.copy(),
            variance=np.zeros(12),
        )

    def _follow(self, vel: FloatArray, rate: float, yaw: float, thrust_n: FloatArray, dt_s: float) -> None:
        """An observer: what the model's velocity over ground lacks is put down to the water."""
        c, s = math.cos(yaw), math.sin(yaw)
        north, east, _ = self.current
        flow_u, flow_v = c * north + s * east, c * east - s * north
        if self._through is None:
            self._through = np.array([vel[0] - flow_u, vel[1] - flow_v])
        u, v = self._through
        du, dv, _, _ = body_acceleration(self._model, (u, v, float(vel[2]), rate), thrust_n.tolist(), math)
        self._through = self._through + dt_s * np.array([du, dv])
        lack = vel[:2] - self._through - [flow_u, flow_v]
        self._through = self._through + dt_s * 2.0 * lack
        gain = dt_s * self._flow_gain
        self.current = self.current + gain * np.array([c * lack[0] - s * lack[1], s * lack[0] + c * lack[1], 0.0])


def fly(
    seed: int, seconds: float, loss: Loss | None, *, spread: float = 0.3, factors: Mapping[str, float] | None = None
) -> Flown:
    """One flight with the detector in the loop, as the service has it; ``factors`` replace those that are drawn."""
    rng = np.random.default_rng(seed)
    assumed = load_vehicle("lbv150")
    model, drive = assumed.to_model(), assumed.drive
    vehicle, mismatch = drawn_vehicle(rng, assumed, spread)
    mismatch |= factors or {}
    tether = (float(rng.uniform(-4.0, 4.0)), float(rng.uniform(-4.0, 4.0)), 0.0) if rng.uniform() < 0.6 else None
    names = [thruster.name for thruster in assumed.thrusters]
    world = SimulatedWaters(
        polygon_ned_m=WALLS_M, floor_m=FLOOR_M, current=drawn_current(rng), tether_entry_ned_m=tether
    )
    start = (*rng.uniform(-1.5, 1.5, 2), float(rng.choice([0.14, 0.5, 0.8])))
    losses = []
    if loss is not None:
        losses.append(ThrusterLoss(at_s=loss.at_s, thruster=names[loss.thruster], loss=1.0 - loss.share))
    plant = Plant(
        vehicle,
        world,
        start_pos_ned_m=start,
        start_rpy_rad=(0.0, 0.0, float(rng.uniform(-3.0, 3.0))),
        mismatch=mismatch,
        losses=losses,
    )
    health = ThrusterHealth(
        model, Response.of(assumed.thrusters), submerged_m=LOSSES.submerged * assumed.hull_half_height_m
    )
    pilot, estimator, allocation = _Pilot(rng, model), _Estimator(rng, model), Allocation(assumed.thrusters)
    acting, pulse_n, flown = np.zeros(THRUSTERS), np.zeros(THRUSTERS), Flown()
    tug_s = float(rng.uniform(8.0, 30.0))
    for tick in range(round(seconds * 1e6 / STEP_US)):
        t_us = tick * STEP_US
        t_s, dt_s = t_us * 1e-6, STEP_US * 1e-6
        if t_s >= tug_s:
            pull = rng.normal(0.0, 1.0, 3) if rng.uniform() < 0.5 else np.zeros(3)
            plant.set_external_wrench(force_ned_n=(float(pull[0]), float(pull[1]), 0.5 * float(pull[2])))
            tug_s = t_s + float(rng.uniform(1.0, 12.0))
        truth = plant.truth
        share = usable(health.found)
        acting = acting + (1.0 - math.exp(-dt_s / drive.time_constant_s)) * (share * pulse_n - acting)
        nav = estimator.nav(truth, acting, dt_s)
        if t_s >= HAND_S:
            _note(flown, health, names, loss, t_s, changed=health.step(t_us, nav, pulse_n))
        thrust = pilot.thrust(t_s, nav) if t_s >= HAND_S else np.zeros(THRUSTERS)
        pulses = allocation.pulses_us(thrust, truth.voltage_v, share)
        pulse_n = allocation.thrusts_n(pulses, truth.voltage_v)
        plant.advance(t_us + STEP_US, pulses)
    flown.found = tuple(health.found.tolist())
    return flown


def _note(
    flown: Flown, health: ThrusterHealth, names: list[str], loss: Loss | None, t_s: float, *, changed: bool
) -> None:
    """Write down what the detector says now."""
    evidence = health.evidence
    for i, name in enumerate(names):
        lost = loss is not None and loss.thruster == i and t_s >= loss.at_s
        if not lost and not health.faulty[i]:
            flown.peak = max(flown.peak, float(evidence[i]))
        if flown.seen_s[i] is None and health.seen[i]:
            flown.seen_s[i] = t_s
        if changed and health.found[i] < 1.0:
            if not lost:
                flown.false.append((t_s, name, float(health.found[i])))
            elif flown.first_s is None:
                flown.first_s = t_s
