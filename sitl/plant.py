"""The simulated vehicle: pulses in, truth out. Its equations (:mod:`sitl.rigid_body`) are not the controller's.

The plant advances in fixed steps of 5 ms. Within a step the pulses, the supply voltage and the gradient of the current
are held, the thrust follows its lag exactly, and the hull is integrated by Runge-Kutta 4. Nothing is random here.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, quat_from_rpy, r_ned_from_frd, rpy_from_quat
from autopilot.core.messages import MAX_THRUSTERS
from autopilot.core.vehicle import Vec3, Vehicle
from sitl.battery import Battery
from sitl.contact import NEAR_M, ContactLog, ContactRecord, Surroundings
from sitl.mismatch import mismatched
from sitl.rigid_body import Flow, ForceNed, State, Wrench, make_derivative, rk4_step
from sitl.scenario_tables import Scenario, ThrusterLoss
from sitl.tether import tether_force_ned_n
from sitl.thrusters import Thrusters
from sitl.world import World, build_world

STEP_US = 5_000
"""Integration step: 200 Hz, 30 steps in the thruster lag of 0.15 s."""

GRAVITY_M_S2 = 9.80665
"""Standard gravity, for what an accelerometer feels."""

ZERO: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Truth:
    """Where the vehicle really is and what it really does."""

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
    """(3,) specific force: what an accelerometer at the centre of gravity feels, (0, 0, -9.81) at rest."""
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
    """How far the top of the hull stands out of the water, 0 = submerged."""


class Plant:
    """One vehicle in one world."""

    def __init__(
        self,
        vehicle: Vehicle,
        world: World,
        *,
        start_pos_ned_m: Sequence[float],
        start_rpy_rad: Sequence[float] = ZERO,
        start_vel_frd_m_s: Sequence[float] = ZERO,
        start_rate_frd_rad_s: Sequence[float] = ZERO,
        mismatch: Mapping[str, float] | None = None,
        held: bool = False,
        losses: Sequence[ThrusterLoss] = (),
        froude_krylov: bool = True,
    ) -> None:
        """Place the vehicle at a position (3,) NED, attitude (3,), velocity over ground and rate (3,) FRD.

        ``mismatch`` holds factors (:data:`sitl.mismatch.MISMATCH_KEYS`). ``held``: a hand holds the hull where it is
        until a thruster is commanded for the first time. ``losses`` happen at their times. ConfigError: unknown factor
        or thruster, or the start touches something.
        """
        self._vehicle = mismatched(vehicle, mismatch or {})
        self._world = world
        self._held = held
        self._t_us = 0
        quat = quat_from_rpy(np.asarray(start_rpy_rad, dtype=np.float64))
        start = (*start_pos_ned_m, *quat, *start_vel_frd_m_s, *start_rate_frd_rad_s)
        self._state: State = [float(value) for value in start]
        self._checked_at: Sequence[float] = self._state[:3]
        self._clearance_m = -math.inf
        self._derivative = make_derivative(
            self._vehicle.body,
            world.current,
            hull_half_height_m=vehicle.hull_half_height_m,
            froude_krylov=froude_krylov,
        )
        self._surroundings = Surroundings(
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
        self._thrusters = Thrusters(self._vehicle.drive, len(self._vehicle.thruster))
        self._losses = sorted(losses, key=lambda loss: loss.at_s)
        for loss in self._losses:
            self._thruster_index(loss.thruster)
        self._columns = [_wrench_column(t.position_frd_m, t.direction_frd) for t in self._vehicle.thruster]
        self._external: Wrench = (0.0,) * 9
        self._battery = Battery(self._vehicle.battery)
        self._battery.load(self._power_w())

    # What happens.

    @property
    def contacts(self) -> tuple[ContactRecord, ...]:
        """Every contact of the hull so far (at most :data:`sitl.contact.MAX_RECORDS`)."""
        return self._contacts.records

    @property
    def truth(self) -> Truth:
        """The present truth."""
        state = np.array(self._state)
        quat, vel = state[3:7], state[7:10]
        rpy = rpy_from_quat(quat)
        r = r_ned_from_frd(rpy)
        current = np.array(self._world.current.velocity(self._state[:3], self._t_us * 1e-6))
        acting = self._thrusters.thrust_n
        return Truth(
            t_us=self._t_us,
            pos_ned_m=state[0:3],
            rpy_rad=rpy,
            quat=quat,
            vel_frd_m_s=vel,
            vel_water_frd_m_s=vel - current @ r,
            rate_frd_rad_s=state[10:13],
            accel_frd_m_s2=np.array(self._specific_force(r)),
            current_ned_m_s=current,
            thrust_n=np.array(acting + [0.0] * (MAX_THRUSTERS - len(acting))),
            power_w=self._power_w(),
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
        """Move on to time ``t_us`` with the pulses (one per thruster, missing = off) held."""
        if t_us < self._t_us:
            raise ValueError(f"t_us = {t_us} lies before the present, {self._t_us}")
        while self._t_us < t_us:
            self._step(min(STEP_US, t_us - self._t_us), pwm_us)

    # What is done to the vehicle.

    def set_thruster_loss(self, name: str, loss: float) -> None:
        """From now on the thruster of that name gives ``1 - loss`` of its thrust. ConfigError if there is none."""
        self._thrusters.set_loss(self._thruster_index(name), loss)

    def set_external_wrench(
        self, *, force_ned_n: Vec3 = ZERO, force_frd_n: Vec3 = ZERO, moment_frd_n_m: Vec3 = ZERO
    ) -> None:
        """A further force and moment on the hull from now on (a push, a payload), replacing the one before."""
        self._external = (*force_frd_n, *moment_frd_n_m, *force_ned_n)

    # Inside.

    def _thruster_index(self, name: str) -> int:
        names = [thruster.name for thruster in self._vehicle.thruster]
        if name not in names:
            raise ConfigError(f"thruster {name!r} does not exist; use one of {', '.join(names)}")
        return names.index(name)

    def _power_w(self) -> float:
        return self._vehicle.hotel_power_w + self._thrusters.power_w

    def _step(self, dt_us: int, pwm_us: Sequence[int]) -> None:
        dt_s = dt_us * 1e-6
        while self._losses and self._losses[0].at_s * 1e6 <= self._t_us:
            happened = self._losses.pop(0)
            self.set_thruster_loss(happened.thruster, happened.loss)
        supply_v = 0.0 if self._battery.empty else self._battery.voltage_v
        self._thrusters.step(pwm_us, supply_v, dt_s)
        self._battery.step(self._power_w(), dt_s)
        if self._held and self._thrusters.commanded(pwm_us):
            self._held = False
        if not self._held:
            wrench = self._wrench(self._thrusters.mean_n)
            t_s = self._t_us * 1e-6
            near = self._near()
            self._state = rk4_step(self._derivative, self._state, t_s, dt_s, wrench, self._flow(), self._force())
            if near:
                self._contacts.update(self._t_us + dt_us, self._surroundings.touches(self._state[:3]))
        self._t_us += dt_us

    def _near(self) -> bool:
        """Whether the hull may be closer than NEAR_M to anything. Looks again only after it moved far enough."""
        x, y, z = self._state[:3]
        cx, cy, cz = self._checked_at
        if abs(x - cx) + abs(y - cy) + abs(z - cz) >= self._clearance_m - NEAR_M:
            self._checked_at = (x, y, z)
            self._clearance_m = self._surroundings.clearance_m(self._checked_at)
        return self._clearance_m < NEAR_M

    def _flow(self) -> Flow | None:
        """Gradient and rate of the current here and now, None where it is steady and uniform."""
        field = self._world.current
        if field.steady_uniform:
            return None
        place, t_s = self._state[:3], self._t_us * 1e-6
        return field.gradient(place, t_s), field.rate(place, t_s)

    def _force(self) -> ForceNed | None:
        """What acts on the hull from outside here and now, None in open water without a tether."""
        if self._near():
            return self._tether_and_contact
        return self._tether if self._world.tether_entry_ned_m is not None else None

    def _tether(self, pos_ned_m: Vec3, vel_ned_m_s: Vec3, vel_water_ned_m_s: Vec3) -> Vec3:
        """Force of the tether (3,) NED [N]."""
        entry = self._world.tether_entry_ned_m
        if entry is None:
            return ZERO
        return tether_force_ned_n(self._vehicle.tether, entry, pos_ned_m, vel_water_ned_m_s)

    def _tether_and_contact(self, pos_ned_m: Vec3, vel_ned_m_s: Vec3, vel_water_ned_m_s: Vec3) -> Vec3:
        """Force of tether and contact (3,) NED [N]."""
        tn, te, td = self._tether(pos_ned_m, vel_ned_m_s, vel_water_ned_m_s)
        cn, ce, cd = self._surroundings.force_ned_n(pos_ned_m, vel_ned_m_s)
        return tn + cn, te + ce, td + cd

    def _wrench(self, thrust_n: Sequence[float]) -> Wrench:
        """Thrust and external wrench together."""
        fx, fy, fz, kx, ky, kz, fn, fe, fd = self._external
        for (dx, dy, dz, mx, my, mz), thrust in zip(self._columns, thrust_n, strict=True):
            fx += dx * thrust
            fy += dy * thrust
            fz += dz * thrust
            kx += mx * thrust
            ky += my * thrust
            kz += mz * thrust
        return fx, fy, fz, kx, ky, kz, fn, fe, fd

    def _specific_force(self, r_ned_from_frd_: FloatArray) -> Vec3:
        """What an accelerometer at the centre of gravity feels (3,) FRD: its acceleration minus gravity."""
        gx, gy, gz = (GRAVITY_M_S2 * float(a) for a in r_ned_from_frd_[2])
        if self._held:
            return -gx, -gy, -gz
        wrench = self._wrench(self._thrusters.thrust_n)
        change = self._derivative(self._state, self._t_us * 1e-6, wrench, self._flow(), self._force())
        u, v, w, p, q, r = self._state[7:13]
        return change[7] + q * w - r * v - gx, change[8] + r * u - p * w - gy, change[9] + p * v - q * u - gz


def _wrench_column(position_frd_m: Vec3, direction_frd: Vec3) -> tuple[float, float, float, float, float, float]:
    """Force and moment of 1 N of a thruster: direction d (normalised) and position x d."""
    norm = math.hypot(*direction_frd)
    if norm == 0.0:
        raise ConfigError("thruster.direction_frd = [0, 0, 0] has no direction; give a vector that is not zero")
    dx, dy, dz = (component / norm for component in direction_frd)
    px, py, pz = position_frd_m
    return dx, dy, dz, py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx


def build_plant(scenario: Scenario, vehicle: Vehicle) -> Plant:
    """The plant of a scenario, thruster faults included. ConfigError if the start is outside the tank or touches."""
    start = scenario.vehicle
    return Plant(
        vehicle,
        build_world(scenario),
        start_pos_ned_m=start.start_m,
        start_rpy_rad=(0.0, 0.0, start.start_yaw_rad),
        mismatch=start.mismatch,
        held=start.held,
        losses=[fault for fault in scenario.fault if isinstance(fault, ThrusterLoss)],
    )
