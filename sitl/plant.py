"""The simulated vehicle: pulses in, truth out. Its equations (:mod:`.sitl.rigid_body`) are not the controller's.

Fixed steps, shorter ones near solids. Within a step the pulses, the supply voltage and the gradient of the current are
constant, the thrust lag is integrated exactly, and the hull by Runge-Kutta 4. Nothing is random.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np

from autopilot.core import compiled
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, quat_from_rpy, r_ned_from_frd
from autopilot.core.messages import MAX_THRUSTERS
from autopilot.core.toml_table import Vec2, Vec3
from autopilot.core.vehicle import Vehicle
from autopilot.sitl.battery import SimulatedBattery
from autopilot.sitl.compiled_hull import STRUCTS, CompiledHull
from autopilot.sitl.contact import ContactLog, ContactRecord, Cylinder, Prism, SolidGeometry, Sphere, moved_to
from autopilot.sitl.current_fields import WithFlow
from autopilot.sitl.fault_tables import BatterySag, Mishap, Shove, Snag
from autopilot.sitl.mishaps import ScheduledFaults
from autopilot.sitl.mismatch import mismatched
from autopilot.sitl.rigid_body import ForceNed, State, Water, Wrench, make_derivative, rk4_step
from autopilot.sitl.scenario_tables import Scenario, ThrusterLoss
from autopilot.sitl.simulated_waters import SimulatedWaters, build_world
from autopilot.sitl.sitl_tuning import CONTACT, PLANT
from autopilot.sitl.tether import make_tether
from autopilot.sitl.thruster_models import Thrusters, wrench_of

Push: TypeAlias = tuple[float, float, float, float, float, float]
"""Force [N] and moment [N m] in the body frame."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Truth:
    """True state of the simulated vehicle."""

    t_us: int
    pos_ned_m: FloatArray
    """(3,) of the centre of gravity."""
    rpy_rad: FloatArray
    """(3,)"""
    quat: FloatArray
    """(4,) w x y z, body to world."""
    vel_frd_m_s: FloatArray
    """(3,) over ground."""
    vel_water_frd_m_s: FloatArray
    """(3,) relative to the water."""
    rate_frd_rad_s: FloatArray
    """(3,)"""
    accel_frd_m_s2: FloatArray
    """(3,) specific force at the centre of gravity, (0, 0, -9.81) at rest."""
    current_ned_m_s: FloatArray
    """(3,) at the centre of gravity."""
    thrust_n: FloatArray
    """(8,) acting, unused = 0."""
    power_w: float
    """Electrical, thrusters and everything else."""
    voltage_v: float
    current_a: float
    energy_used_j: float
    energy_remaining: float
    """0..1"""
    contact_depth_m: float
    """Deepest penetration of the hull into wall, floor or obstacle now, 0 = free."""
    contact_count: int
    """Contacts since the start."""
    max_penetration_m: float
    """Deepest penetration since the start."""
    emerged_m: float
    """Height of the hull's top above the surface, 0 = submerged."""

    def depth_of(self, point_frd_m: FloatArray) -> float:
        """Depth of a point (3,) of the body, given from the centre of gravity [m]."""
        return float(self.pos_ned_m[2]) + float(r_ned_from_frd(self.rpy_rad)[2] @ point_frd_m)


class _Instant(NamedTuple):
    """Quantities at one time, for the truth and for the step that starts there."""

    near: bool
    """The hull may be closer than NEAR_M to something."""
    water: Water
    force: ForceNed | None
    """External force on the hull, None in open water without a tether."""
    change: State | CompiledHull
    """Derivative of the state without thrust, or who keeps it."""


class Plant:
    """Rigid body with thrusters, battery, tether and contact in the environment of a scenario."""

    def __init__(
        self,
        vehicle: Vehicle,
        world: SimulatedWaters,
        *,
        start_pos_ned_m: Sequence[float],
        start_rpy_rad: Sequence[float] = PLANT.zero,
        start_vel_frd_m_s: Sequence[float] = PLANT.zero,
        start_rate_frd_rad_s: Sequence[float] = PLANT.zero,
        mismatch: Mapping[str, float] | None = None,
        held: bool = False,
        losses: Sequence[ThrusterLoss] = (),
        mishaps: Sequence[Mishap] = (),
        froude_krylov: bool = True,
    ) -> None:
        """Place the vehicle at a position (3,) NED, attitude (3,), velocity over ground and rate (3,) FRD.

        ``mismatch`` holds factors (:data:`.sitl.mismatch.MISMATCH_KEYS`). ``held``: a hand holds the hull where it is
        until a thruster is commanded for the first time. ``losses`` and ``mishaps`` happen at their times.
        ConfigError: unknown factor or thruster, or the start touches something.
        """
        self._vehicle = mismatched(vehicle, mismatch or {})
        self._world = world
        self._held = held
        self._t_us = 0
        quat = quat_from_rpy(np.asarray(start_rpy_rad, dtype=np.float64))
        start = (*start_pos_ned_m, *quat, *start_vel_frd_m_s, *start_rate_frd_rad_s)
        self._state: State = [float(value) for value in start]
        self._checked_at: Sequence[float] = self._state[:3]
        self._checked_us = 0
        self._clearance_m = -math.inf
        self._derivative = make_derivative(
            self._vehicle.body,
            hull_half_height_m=vehicle.hull_half_height_m,
            froude_krylov=froude_krylov,
        )
        entry = world.tether_entry_ned_m
        self._tether = None if entry is None else make_tether(self._vehicle.tether, entry)
        self._surroundings = SolidGeometry(
            polygon_ned_m=world.polygon_ned_m,
            floor_m=world.floor_m,
            solids=world.solids,
            hull_radius_m=vehicle.hull_radius_m,
            hull_half_height_m=vehicle.hull_half_height_m,
        )
        for touch in self._surroundings.touches(self._state[:3]):
            x, y, z = self._state[:3]
            raise ConfigError(
                f"start position [{x:g}, {y:g}, {z:g}] m: the hull is {touch.depth_m:.3f} m inside {touch.what};"
                " move the start away from it"
            )
        self._contacts = ContactLog()
        self._columns = list(zip(*wrench_of(self._vehicle), strict=True))
        self._compiled = self._by_library(froude_krylov)
        self._thrusters = Thrusters(self._vehicle.thrusters, self._compiled)
        self._losses = sorted(losses, key=lambda loss: loss.at_s)
        for loss in self._losses:
            self._thruster_index(loss.thruster)
        self._no_thrust = (0.0,) * (MAX_THRUSTERS - len(self._vehicle.thrusters))
        body = self._vehicle.body
        mass = [body.mass_kg + added for added in body.added_mass_kg]
        inertia = [rigid + added for rigid, added in zip(body.inertia_kg_m2, body.added_inertia_kg_m2, strict=True)]
        self._masses = (*mass, *inertia)
        self._external: Wrench = (0.0,) * 9
        self._instant: _Instant | None = None
        self._battery = SimulatedBattery(self._vehicle.battery)
        self._power_w = self._vehicle.hotel_power_w
        self._battery.load(self._power_w)
        self._mishaps = ScheduledFaults(mishaps)

    # Disturbances and faults.

    @property
    def contacts(self) -> tuple[ContactRecord, ...]:
        """Every contact of the hull so far (at most ``CONTACT.max_records``, :mod:`autopilot.sitl.sitl_tuning`)."""
        return self._contacts.records

    @property
    def truth(self) -> Truth:
        instant = self._here()
        if isinstance(instant.change, CompiledHull):
            numbers = instant.change.measured(self._held)
        else:
            numbers = np.array(self._numbers(instant.water, instant.change))
        return Truth(
            t_us=self._t_us,
            pos_ned_m=numbers[0:3],
            rpy_rad=numbers[13:16],
            quat=numbers[3:7],
            vel_frd_m_s=numbers[7:10],
            vel_water_frd_m_s=numbers[19:22],
            rate_frd_rad_s=numbers[10:13],
            accel_frd_m_s2=numbers[22:25],
            current_ned_m_s=numbers[16:19],
            thrust_n=numbers[25:],
            power_w=self._power_w,
            voltage_v=self._battery.voltage_v,
            current_a=self._battery.current_a,
            energy_used_j=self._battery.used_j,
            energy_remaining=self._battery.remaining,
            contact_depth_m=self._contacts.depth_m,
            contact_count=self._contacts.count,
            max_penetration_m=self._contacts.max_depth_m,
            emerged_m=max(0.0, self._vehicle.hull_half_height_m - self._state[2]),
        )

    def advance(self, t_us: int, pwm_us: Sequence[int]) -> None:
        """Move on to time ``t_us`` with the pulses (one per channel, missing = off) held."""
        if t_us < self._t_us:
            raise ValueError(f"t_us = {t_us} lies before the present, {self._t_us}")
        while self._t_us < t_us:
            self._step(t_us - self._t_us, pwm_us)

    # Faults.

    def set_thruster_loss(self, name: str, loss: float) -> None:
        """From now on the thruster of that name gives ``1 - loss`` of its thrust. ConfigError if there is none."""
        self._thrusters.set_loss(self._thruster_index(name), loss)

    def set_external_wrench(
        self, *, force_ned_n: Vec3 = PLANT.zero, force_frd_n: Vec3 = PLANT.zero, moment_frd_n_m: Vec3 = PLANT.zero
    ) -> None:
        """A further force and moment on the hull from now on (a push, a payload), replacing the one before."""
        self._external = (*force_frd_n, *moment_frd_n_m, *force_ned_n)
        self._instant = None

    def begin_fault(self, fault: ThrusterLoss | Mishap) -> None:
        """Begin a fault of hull, thrusters or battery that is not in the scenario. ConfigError if it is impossible."""
        if isinstance(fault, ThrusterLoss):
            self._thruster_index(fault.thruster)
            self._losses = sorted([*self._losses, fault], key=lambda loss: loss.at_s)
        else:
            self._mishaps.add(fault)

    def add_flow(self, flow_m_s: Vec2) -> None:
        """From now on this flow (north, east) is added to the scenario's current everywhere; the last one counts."""
        field = self._world.current
        scenario = field.field if isinstance(field, WithFlow) else field
        self._world = replace(self._world, current=WithFlow(field=scenario, added_m_s=flow_m_s))
        self._instant = None

    def current_at(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        return self._world.current.velocity(pos_ned_m, t_s)

    @property
    def solids(self) -> tuple[Cylinder | Sphere | Prism, ...]:
        """The obstacles where they are now, in the scenario's order."""
        self._surroundings.move_to(self._t_us * 1e-6)
        return self._surroundings.solids

    def put_obstacle(self, number: int, north_m: float, east_m: float) -> None:
        """The obstacle of that number (from 1) stands there from now on. ConfigError if the hull is there."""
        solids = self.solids
        if not 1 <= number <= len(solids):
            raise ConfigError(f"obstacle {number} does not exist; there are {len(solids)}")
        before = self._surroundings.touches(self._state[:3])
        trial = SolidGeometry(
            polygon_ned_m=None,
            floor_m=None,
            solids=[moved_to(solids[number - 1], north_m, east_m)],
            hull_radius_m=self._vehicle.hull_radius_m,
            hull_half_height_m=self._vehicle.hull_half_height_m,
        )
        if trial.touches(self._state[:3]) and not any(touch.what == solids[number - 1].name for touch in before):
            raise ConfigError(f"obstacle {number} would stand inside the vehicle; put it elsewhere")
        self._surroundings.put(number, north_m, east_m)
        self._clearance_m, self._instant = -math.inf, None

    # Inside.

    def _numbers(self, water: Water, change: State) -> list[float]:
        """Components of a truth: state, roll, pitch, yaw, current, velocity in the water, specific force, thrust."""
        _, _, _, ew, ex, ey, ez, u, v, w, p, q, r = self._state
        r11, r12, r13 = 1.0 - 2.0 * (ey * ey + ez * ez), 2.0 * (ex * ey - ez * ew), 2.0 * (ex * ez + ey * ew)
        r21, r22, r23 = 2.0 * (ex * ey + ez * ew), 1.0 - 2.0 * (ex * ex + ez * ez), 2.0 * (ey * ez - ex * ew)
        r31, r32, r33 = 2.0 * (ex * ez - ey * ew), 2.0 * (ey * ez + ex * ew), 1.0 - 2.0 * (ex * ex + ey * ey)
        cn, ce, cd = water.current_ned_m_s
        thrust_n = self._thrusters.thrust_n
        if self._held:
            ax = ay = az = 0.0
        else:
            fx, fy, fz, *_ = self._push(thrust_n)
            mx, my, mz, *_ = self._masses
            du, dv, dw = change[7:10]
            ax, ay, az = du + fx / mx + q * w - r * v, dv + fy / my + r * u - p * w, dw + fz / mz + p * v - q * u
        rpy = math.atan2(r32, r33), math.asin(max(-1.0, min(1.0, -r31))), math.atan2(r21, r11)
        return [
            *self._state,
            *rpy,
            cn,
            ce,
            cd,
            u - r11 * cn - r21 * ce - r31 * cd,
            v - r12 * cn - r22 * ce - r32 * cd,
            w - r13 * cn - r23 * ce - r33 * cd,
            ax - PLANT.gravity_m_s2 * r31,
            ay - PLANT.gravity_m_s2 * r32,
            az - PLANT.gravity_m_s2 * r33,
            *thrust_n,
            *self._no_thrust,
        ]

    def _by_library(self, froude_krylov: bool) -> CompiledHull | None:
        """The compiled hull, None where there is no library."""
        library = compiled.library(*STRUCTS)
        if library is None:
            return None
        return CompiledHull(
            library,
            self._vehicle.body,
            self._vehicle.thrusters,
            self._columns,
            self._tether,
            hull_half_height_m=self._vehicle.hull_half_height_m,
            froude_krylov=froude_krylov,
            gravity_m_s2=PLANT.gravity_m_s2,
        )

    def _thruster_index(self, name: str) -> int:
        names = [thruster.name for thruster in self._vehicle.thrusters]
        if name not in names:
            raise ConfigError(f"thruster {name!r} does not exist; use one of {', '.join(names)}")
        return names.index(name)

    def _step(self, limit_us: int, pwm_us: Sequence[int]) -> None:
        """One step, no longer than ``limit_us``."""
        while self._losses and self._losses[0].at_s * 1e6 <= self._t_us:
            happened = self._losses.pop(0)
            self.set_thruster_loss(happened.thruster, happened.loss)
        if not self._mishaps.none:
            self._apply_faults()
        instant = self._here()
        dt_us = min(PLANT.near_step_us if instant.near else PLANT.step_us, limit_us)
        dt_s = dt_us * 1e-6
        supply_v = 0.0 if self._battery.empty else self._battery.voltage_v
        self._thrusters.step(pwm_us, supply_v, dt_s)
        before_w, self._power_w = self._power_w, self._vehicle.hotel_power_w + self._thrusters.power_w
        self._battery.step(before_w, self._power_w, dt_s)
        self._t_us += dt_us
        self._instant = None
        if self._held and self._thrusters.commanded(pwm_us):
            self._held = False
        if self._held:
            return
        change = instant.change
        if isinstance(change, CompiledHull):
            self._state = change.step(dt_s)
            return
        push = self._push(self._thrusters.mean_n)
        fx, fy, fz, kx, ky, kz, fn, fe, fd = self._external
        px, py, pz, pk, pm, pn = push
        wrench: Wrench = (fx + px, fy + py, fz + pz, kx + pk, ky + pm, kz + pn, fn, fe, fd)
        # The equations are linear in the thrust.
        first = change[:7] + [c + a / m for c, a, m in zip(change[7:], push, self._masses, strict=True)]
        self._state = rk4_step(self._derivative, self._state, first, dt_s, wrench, instant.water, instant.force)
        if instant.near:
            self._contacts.update(self._t_us, self._surroundings.touches(self._state[:3]))

    def _apply_faults(self) -> None:
        """Apply the active faults of hull and battery."""
        remaining = self._mishaps.sagged(self._t_us)
        if remaining is not None:
            self._battery.lose(remaining)
        forces = self._mishaps.forces(self._t_us, self._state)
        if forces is not None:
            self.set_external_wrench(force_ned_n=forces[0], moment_frd_n_m=forces[1])

    def _here(self) -> _Instant:
        """The present instant, evaluated once per time."""
        if self._instant is None:
            x, y, z = place = (self._state[0], self._state[1], self._state[2])
            self._surroundings.move_to(self._t_us * 1e-6)
            near = self._near(x, y, z)
            field, t_s = self._world.current, self._t_us * 1e-6
            flow = None if field.steady_uniform else (field.gradient(place, t_s), field.rate(place, t_s))
            water = Water(field.velocity(place, t_s), place, flow)
            force = self._outside if near or self._tether is not None else None
            change: State | CompiledHull
            if self._compiled is not None and not near:
                change = self._compiled
                change.evaluate(self._state, water, self._external)
            else:
                change = self._derivative(self._state, 0.0, self._external, water, force)
            self._instant = _Instant(near, water, force, change)
        return self._instant

    def _near(self, x: float, y: float, z: float) -> bool:
        """Whether the hull may be closer than NEAR_M to anything. Looks again only after enough has moved."""
        cx, cy, cz = self._checked_at
        came_m = self._surroundings.fastest_m_s * (self._t_us - self._checked_us) * 1e-6
        if abs(x - cx) + abs(y - cy) + abs(z - cz) + came_m >= self._clearance_m - CONTACT.near_m:
            self._checked_at, self._checked_us = (x, y, z), self._t_us
            self._clearance_m = self._surroundings.clearance_m(self._checked_at)
        return self._clearance_m < CONTACT.near_m

    def _outside(self, pos_ned_m: Vec3, vel_ned_m_s: Vec3, vel_water_ned_m_s: Vec3) -> Vec3:
        """Force of tether and contact (3,) NED [N]."""
        tn, te, td = PLANT.zero if self._tether is None else self._tether(pos_ned_m, vel_water_ned_m_s)
        if self._clearance_m >= CONTACT.near_m:
            return tn, te, td
        cn, ce, cd = self._surroundings.force_ned_n(pos_ned_m, vel_ned_m_s)
        return tn + cn, te + ce, td + cd

    def _push(self, thrust_n: Sequence[float]) -> Push:
        """Force and moment of the thrusters in the body frame."""
        fx = fy = fz = kx = ky = kz = 0.0
        for (dx, dy, dz, mx, my, mz), thrust in zip(self._columns, thrust_n, strict=True):
            fx += dx * thrust
            fy += dy * thrust
            fz += dz * thrust
            kx += mx * thrust
            ky += my * thrust
            kz += mz * thrust
        return fx, fy, fz, kx, ky, kz


def build_plant(scenario: Scenario, vehicle: Vehicle) -> Plant:
    """The plant of a scenario, thruster faults included.

    Raises
    ------
    ConfigError
        The start is outside the tank or in contact with something.
    """
    start = scenario.vehicle
    return Plant(
        vehicle,
        build_world(scenario),
        start_pos_ned_m=start.start_m,
        start_rpy_rad=(0.0, 0.0, start.start_yaw_rad),
        mismatch=start.mismatch,
        held=start.held,
        losses=[fault for fault in scenario.fault if isinstance(fault, ThrusterLoss)],
        mishaps=[fault for fault in scenario.fault if isinstance(fault, Shove | Snag | BatterySag)],
    )
