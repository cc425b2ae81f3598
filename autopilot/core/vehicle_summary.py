"""Capabilities of a vehicle by its file: authority and speed per axis, power, and missing data."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.model4 import AXES, AXIS_NAMES
from autopilot.core.thrusters import CONTROLLED, wrench_matrix
from autopilot.core.vehicle import DvlMount, Vehicle

CRUISE_M_S = 0.3
"""Ahead, where the power of cruising is told."""

TILTING = 1e-6
"""Share of the thrusters' moments below which they do not push roll or pitch."""

UNSOURCED = frozenset({"name", "description", "sources", "payload"})
"""Keys that need no source."""

APART = 2.0
"""Factor between two entries of one quantity from which on they contradict each other."""

BUOYANCY_SHARE = 0.05
"""The same for buoyancies, as a share of the weight."""

NAMED = 8
"""So many keys without a source are named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisSummary:
    axis: str
    authority: float
    """Force [N], of yaw moment [N m], that the thrusters make alone and both ways, buoyancy not counted."""
    speed: float
    """Steady speed [m/s], of yaw [rad/s], that it gives; of heave the slower of down and up. inf without drag."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleSummary:
    axes: tuple[AxisSummary, ...]
    hover_w: float
    """Electrical power at rest in still water, everything that is not a thruster included."""
    cruise_w: float
    """The same ahead at :data:`CRUISE_M_S`."""
    tilts: tuple[str, ...]
    """Of roll and pitch those that the thrusters push independently of the controlled axes: levelled in flight."""
    missing: tuple[str, ...]
    """What the file does not say, a line each."""
    contradictions: tuple[str, ...]
    """Where the plant's tables and the controller's describe two vehicles, a line each."""


def facts_of(vehicle: Vehicle) -> VehicleSummary:
    """From a file that has been read."""
    allocator, model = ControlAllocator.of(vehicle), vehicle.to_model()
    limit_n = np.array([thruster.limit_n for thruster in vehicle.thrusters])
    reach = allocator.reach(limit_n)
    axes = []
    for i in range(AXES):
        force = float(reach[i]) - (abs(model.buoyancy_excess_n) if i == 2 else 0.0)
        speed = terminal_speed(force, model.linear_drag[i], model.quadratic_drag[i])
        axes.append(AxisSummary(axis=AXIS_NAMES[i], authority=float(reach[i]), speed=speed))
    ahead = model.linear_drag[0] * CRUISE_M_S + model.quadratic_drag[0] * CRUISE_M_S**2
    return VehicleSummary(
        axes=tuple(axes),
        hover_w=_power_w(vehicle, allocator, 0.0),
        cruise_w=_power_w(vehicle, allocator, ahead),
        tilts=tilts_of(vehicle),
        missing=tuple(_missing(vehicle)),
        contradictions=tuple(_contradictions(vehicle)),
    )


def terminal_speed(force: float, linear: float, quadratic: float) -> float:
    """Speed at which linear and quadratic drag equal that force."""
    if force <= 0.0:
        return 0.0
    if quadratic == 0.0:
        return math.inf if linear == 0.0 else force / linear
    return (math.sqrt(linear * linear + 4.0 * quadratic * force) - linear) / (2.0 * quadratic)


def tilts_of(vehicle: Vehicle) -> tuple[str, ...]:
    """Those of roll and pitch that thrust can produce without force or moment in surge, sway, heave and yaw."""
    thrusters = vehicle.thrusters
    wrench = np.array(wrench_matrix([t.position_frd_m for t in thrusters], [t.direction_frd for t in thrusters]))
    controlled, found = wrench[list(CONTROLLED)], []
    idle = np.eye(len(thrusters)) - np.linalg.pinv(controlled) @ controlled
    for name, row in (("roll", 3), ("pitch", 4)):
        if float(np.abs(wrench[row] @ idle).max()) > TILTING * max(float(np.abs(wrench[3:]).max()), TILTING):
            found.append(name)
    return tuple(found)


def _power_w(vehicle: Vehicle, allocator: ControlAllocator, ahead_n: float) -> float:
    force = np.array([ahead_n, 0.0, allocator.model.buoyancy_excess_n, 0.0])
    thrust_n = allocator.thrust_n(force, np.array([thruster.limit_n for thruster in vehicle.thrusters]))
    total = vehicle.hotel_power_w
    for thruster, thrust in zip(vehicle.thrusters, thrust_n.tolist(), strict=True):
        drive = thruster.drive
        c = drive.power_w_n15 if thrust >= 0.0 else drive.reverse_power_w_n15 or drive.power_w_n15
        total += c * abs(thrust) ** 1.5
    return total


def _contradictions(vehicle: Vehicle) -> Iterator[str]:
    body, model = vehicle.body, vehicle.model4
    same = [
        ("model4.dry_mass_kg", model.dry_mass_kg, "body.mass_kg", body.mass_kg),
        ("body.weight_n", body.weight_n, "body.mass_kg times 9.81", body.mass_kg * 9.81),
    ]
    for i, added in enumerate((*body.added_mass_kg, body.added_inertia_kg_m2[2])):
        own, name = (body.mass_kg, "mass_kg") if i < 3 else (body.inertia_kg_m2[2], "inertia_kg_m2")
        same.append((f"model4.mass_kg[{i}]", model.mass_kg[i], f"body.{name} and what is added", own + added))
    for i in range(3):
        ours, plants = (
            linear[i] * CRUISE_M_S + quadratic[i] * CRUISE_M_S**2
            for linear, quadratic in (
                (model.linear_drag, model.quadratic_drag),
                (body.linear_drag_n_s_m, body.quadratic_drag_n_s2_m2),
            )
        )
        same.append((f"model4 at {CRUISE_M_S:g} m/s: drag[{i}]", ours, "body's", plants))
    for ours_name, ours, plants_name, plants in same:
        if not ours <= APART * plants <= APART**2 * ours:
            yield f"{ours_name} = {ours:.4g} and {plants_name} = {plants:.4g} contradict each other; correct one"
    if model.buoyancy_excess_n * body.buoyancy_excess_n < 0.0 or (
        abs(model.buoyancy_excess_n - body.buoyancy_excess_n) > BUOYANCY_SHARE * body.weight_n
    ):
        yield (
            f"buoyancy_excess_n = {model.buoyancy_excess_n:g} of model4 and {body.buoyancy_excess_n:g} of body"
            " contradict each other (positive: it floats); correct one"
        )
    if body.center_of_buoyancy_frd_m[2] > 0.0:
        yield (
            f"body.center_of_buoyancy_frd_m[2] = {body.center_of_buoyancy_frd_m[2]:g} is below the centre of gravity:"
            " it turns over; above is negative"
        )


def _missing(vehicle: Vehicle) -> list[str]:
    remarks = []
    if vehicle.camera is None:
        remarks.append("no [camera]: no markers are seen; a position has to come from outside (sitl --sensors pose)")
    if vehicle.laser is None:
        remarks.append("no [laser]: no altitude by a dot; markers, depth sensor or DVL give it")
    open_ = _uncalibrated(vehicle)
    if open_:
        remarks.append(f"not calibrated, so as good as a ruler: {', '.join(open_)}")
    sources = vehicle.sources
    lacking = [key for key in _given(vehicle) if key not in sources and key.partition(".")[0] not in sources]
    if lacking:
        more = f" and {len(lacking) - NAMED} more" if len(lacking) > NAMED else ""
        remarks.append(f"[sources] says nothing of {', '.join(lacking[:NAMED])}{more}")
    assumed = sum(text.startswith("assumed") for text in sources.values())
    if assumed:
        remarks.append(
            f'{assumed} values have "assumed" as their source: autopilot identify and calibrate replace some'
        )
    return remarks


def _uncalibrated(vehicle: Vehicle) -> list[str]:
    """Keys of camera, laser and Doppler log whose standard deviation is the default."""
    dvl = None if vehicle.dvl == DvlMount() else vehicle.dvl
    tables: dict[str, msgspec.Struct | None] = {"camera": vehicle.camera, "laser": vehicle.laser, "dvl": dvl}
    return [
        f"{name}.{field.name}"
        for name, table in tables.items()
        if table is not None
        for field in msgspec.structs.fields(table)
        if "_sigma" in field.name and getattr(table, field.name) == field.default
    ]


def _given(vehicle: Vehicle) -> list[str]:
    """``key`` or ``table.key`` of every value that needs a source; defaults need none."""
    result = []
    for field in msgspec.structs.fields(vehicle):
        value = getattr(vehicle, field.name)
        if field.encode_name in UNSOURCED or value is None:
            continue
        if isinstance(value, msgspec.Struct):
            keys = [inner.encode_name for inner in msgspec.structs.fields(value) if not _default(inner, value)]
            result += [f"{field.encode_name}.{key}" for key in keys]
        else:
            result.append(field.encode_name)
    return result


def _default(field: msgspec.structs.FieldInfo, table: msgspec.Struct) -> bool:
    """Whether the table leaves that key as it is without an entry."""
    if field.default_factory is not msgspec.NODEFAULT:
        return bool(getattr(table, field.name) == field.default_factory())
    return field.default is not msgspec.NODEFAULT and bool(getattr(table, field.name) == field.default)
