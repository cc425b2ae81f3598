"""What telemetry shows of a tick."""

from autopilot.command.decision import Decision
from autopilot.command.estimation import Estimation
from autopilot.command.service_parts import Parts
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Inputs, NavState, NmpcStatus, ThrusterCommand
from autopilot.core.samples import PowerSample
from autopilot.core.sensed import Sensed
from autopilot.mavlink.api import VehicleView


def vehicle_view(
    parts: Parts,
    inputs: Inputs,
    nav: NavState | None,
    estimation: Estimation,
    power: PowerSample | None,
    control: NmpcStatus | None,
    ahead: FloatArray | None,
    sensed: Sensed,
    decision: Decision | None,
    command: ThrusterCommand | None,
) -> VehicleView:
    """The estimate is of this tick, ``decision`` and ``command`` are of the last one."""
    commander = parts.commander
    goal = None if decision is None else decision.goal
    return VehicleView(
        t_us=inputs.t_us,
        armed=commander.shows_armed,
        mode=commander.mode,
        intended_mode=commander.intended_mode,
        nav=nav,
        power=power,
        command=command,
        progress=None if decision is None else decision.progress,
        target_ned_m=None if goal is None else goal.pos_ned_m,
        origin=parts.plans.origin,
        home=parts.plans.home,
        prearm_reasons=commander.readiness,
        refusals=inputs.refusals,
        fenced=commander.fenced,
        failsafes=0 if decision is None else decision.failsafes,
        cpu_load=inputs.cpu_load,
        under_way=commander.under_way,
        dropped_rx=parts.server.dropped_rx,
        aid_ratio=estimation.aid_ratio,
        nav_errors=estimation.errors,
        nav_doubts=estimation.doubts,
        control=control,
        ahead=ahead,
        sensed=sensed,
        energy_left_j=None if power is None else power.remaining * parts.vehicle.battery.capacity_j,
    )
