"""Every failsafe through each of its causes: the real service, which hears a cause as it would in the water.

The table is the list: a row without a cause here fails, and so does a row that looks at one more quantity.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as mav
from service_world import TICK_US, ServiceWorld

from autopilot.command.failsafe_table import _DOUBTS, RANK, ROWS, FailsafeRow
from autopilot.core.messages import (
    Authority,
    DeviceRole,
    DeviceTrouble,
    Failsafe,
    FlightControllerState,
    NavDoubt,
    NavHealth,
    NavState,
    Outputs,
    SolveStatus,
)
from autopilot.core.plan import PlanKind
from autopilot.core.samples import AhrsSample, DepthSample, HullSample, LeakSample, PowerSample, Sample, VelocitySample
from autopilot.mission.paper import paper_plan

ARM, MODE = mav.MAV_CMD_COMPONENT_ARM_DISARM, mav.MAV_CMD_DO_SET_MODE
HEARTBEAT = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


class KnownEnvironment:
    """The estimator, with what it says changed."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner
        self.change: Callable[[NavState], NavState] = lambda nav: nav
        self.fields: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        fields = self.__dict__.get("fields", {})
        return fields[name] if name in fields else getattr(self._inner, name)

    def step(self, *given: Any) -> NavState | None:
        nav: NavState | None = self._inner.step(*given)
        return None if nav is None else self.change(nav)


class CauseWorld(ServiceWorld):
    """Armed, at rest, all sensors sound."""

    def __init__(self, params: dict[str, float]) -> None:
        super().__init__(params)
        self.fields: dict[str, Any] = {}
        self.power = {"voltage_v": 19.0, "remaining": 0.9, "energy_used_j": 0.0}
        self.also: Callable[[int], Sequence[Sample]] = lambda _: ()
        self.drop: tuple[type, ...] = ()
        self.each: Callable[[], None] = lambda: None
        self.rx: Callable[[int], Sequence[bytes]] = lambda _: ()
        self.nav = KnownEnvironment(self.service._estimation._estimator)
        self.service._estimation._estimator = self.nav  # type: ignore[assignment]
        self.parts.guard.raises = False
        self.bits = 0

    def samples(self) -> tuple[Sample, ...]:
        kept = [s for s in super().samples() if not isinstance(s, (PowerSample, *self.drop))]
        if self.t_us % 100_000 == 0 and PowerSample not in self.drop:
            kept.append(PowerSample(t_us=self.t_us, current_a=1.0, **self.power))
        return (*kept, *self.also(self.t_us))

    def camera(self) -> dict[str, Any]:
        return self.fields

    def tick(self, rx: Sequence[bytes] = (), samples: Sequence[Sample] | None = None) -> Outputs:
        self.each()
        outputs = super().tick((*rx, *self.rx(self.t_us)), samples)
        self.bits |= outputs.mode.failsafes
        return outputs

    def take_off(self) -> None:
        self.run(2.0)
        assert self.command(ARM, 1.0) == 0, self.texts()

    def answer(self, change: Callable[[NavState], NavState]) -> None:
        self.nav.change = change


Act = Callable[[CauseWorld], None]


@dataclass(frozen=True, kw_only=True)
class Cause:
    """One way into a row."""

    rule: Failsafe
    name: str
    quantity: str
    """Of the row's, which this cause is about."""
    act: Act
    within_s: float = 1.0
    """By then it has begun."""
    not_before_s: float = 0.0
    prepare: Act = lambda world: None
    params: dict[str, float] = field(default_factory=dict)


def _nav(**fields: Callable[[Any], Any]) -> Act:
    return lambda world: world.answer(
        lambda nav: replace(nav, **{name: change(getattr(nav, name)) for name, change in fields.items()})
    )


def _set(**fields: Any) -> Act:
    return lambda world: world.power.update(fields) if "remaining" in fields or "voltage_v" in fields else None


def _also(make: Callable[[int], Sequence[Sample]]) -> Act:
    return lambda world: setattr(world, "also", make)


def _inputs(**fields: Any) -> Act:
    return lambda world: world.fields.update(fields)


def _at(numbers: Any, place: int, value: float) -> Any:
    changed = numbers.copy()
    changed[place] = value
    return changed


def _failing(world: CauseWorld) -> None:
    step = world.parts.controller.step

    def unsolved(*given: Any, **named: Any) -> Any:
        control = step(*given, **named)
        return replace(control, status=replace(control.status, status=SolveStatus.RESIDUAL))

    world.parts.controller.step = unsolved  # type: ignore[method-assign]


def _broken(world: CauseWorld) -> None:
    world.parts.controller.step = lambda *_, **__: 1 / 0  # type: ignore[method-assign,return-value,assignment]


def _late(world: CauseWorld) -> None:
    delay = world.service._actuation.delay
    delay.step = lambda *_, **__: setattr(delay, "delay_s", 0.8)  # type: ignore[method-assign]


def _overload(world: CauseWorld) -> None:
    world.each = lambda: world.fields.update(overruns=world.fields.get("overruns", 0) + 1)


def _jolt(world: CauseWorld) -> None:
    begin_us = world.t_us
    inner = world.samples

    def shaken() -> tuple[Sample, ...]:
        jolts = begin_us < world.t_us <= begin_us + 50_000
        return tuple(
            replace(s, accel_frd_m_s2=s.accel_frd_m_s2 + np.array([8.0, 0.0, 0.0]))
            if jolts and isinstance(s, AhrsSample)
            else s
            for s in inner()
        )

    world.samples = shaken  # type: ignore[method-assign]


def _frozen_ahrs(world: CauseWorld) -> None:
    one = next(s for s in world.samples() if isinstance(s, AhrsSample))
    world.drop, world.also = (AhrsSample,), lambda t_us: (replace(one, t_us=t_us),)


def _went(world: CauseWorld) -> None:
    """To somewhere that it is held back from: thrust, and no motion."""
    assert world.command_int(mav.MAV_CMD_DO_REPOSITION, 1.5, 0.0, 0.4, frame=1) == 0


def _fly(world: CauseWorld) -> None:
    plan = paper_plan(3)
    assert world.parts.plans.replace(PlanKind.FENCE, plan.fence) is None
    assert world.parts.plans.replace(PlanKind.MISSION, plan.mission) is None


def _on_mission(world: CauseWorld) -> None:
    """A tenth of the battery for every metre. The estimate moves: a hull that fixes alone move has a camera that is
    not believed."""
    assert world.command(mav.MAV_CMD_MISSION_START) == 0, world.texts()
    capacity_j = world.vehicle.battery.capacity_j

    def spend() -> None:
        world.power["energy_used_j"] += 0.01 * 0.1 * 0.1 * capacity_j

    def moved(nav: NavState) -> NavState:
        return replace(nav, pos_ned_m=nav.pos_ned_m - [0.5 * math.sin(0.2 * nav.t_us * 1e-6), 0.0, 0.0])

    world.each = spend
    world.answer(moved)
    world.power["remaining"] = 0.5


def _wander(world: CauseWorld) -> None:
    start = world.pos_ned_m.copy()

    def move() -> None:
        world.pos_ned_m = start + np.array([0.3 * math.sin(world.t_us * 1e-6), 0.0, 0.0])

    world.each = move


def _repeated(make: Callable[[int, float], Sample], moves: bool) -> Callable[[int], Sequence[Sample]]:
    def said(t_us: int) -> Sequence[Sample]:
        return (make(t_us, 1e-4 * math.sin(t_us) if moves else 0.0),) if t_us % 100_000 == 0 else ()

    return said


def _depth(t_us: int, more: float) -> Sample:
    return DepthSample(t_us=t_us, depth_m=0.4 + more, sigma_m=0.01)


def _velocity(t_us: int, more: float) -> Sample:
    return VelocitySample(t_us=t_us, vel_frd_m_s=np.array([more, 0.0, 0.0]), sigma_m_s=np.full(3, 0.02))


def _silent() -> list[Cause]:
    """Every sensor that has to go on, by silence, and by one reading for ever where readings move."""
    makers: dict[str, Callable[[int, float], Sample]] = {
        "depth sensor": _depth,
        "velocity log": _velocity,
        "leak probe": lambda t_us, _: LeakSample(t_us=t_us, wet=False),
        "hull sensor": lambda t_us, _: HullSample(t_us=t_us, pressure_pa=90_000.0, temperature_c=20.0),
    }
    common: dict[str, Any] = {"rule": Failsafe.SENSOR, "quantity": "silent_s"}
    causes = [
        Cause(
            name=f"{name} silent",
            prepare=_also(_repeated(make, True)),
            act=_also(lambda _: ()),
            not_before_s=2.7,
            within_s=4.0,
            **common,
        )
        for name, make in makers.items()
    ]
    causes += [
        Cause(
            name=f"{name} frozen",
            prepare=_also(_repeated(makers[name], True)),
            act=_also(_repeated(makers[name], False)),
            not_before_s=4.0,
            within_s=7.0,
            **common,
        )
        for name in ("depth sensor", "velocity log")
    ]
    wrong: dict[str, Callable[[int, float], Sample]] = {
        "depth sensor": lambda t_us, more: _depth(t_us, math.nan),
        "velocity log": lambda t_us, more: _velocity(t_us, math.nan if t_us % 200_000 else 30.0 + more),
        "hull sensor": lambda t_us, _: HullSample(t_us=t_us, pressure_pa=math.nan, temperature_c=20.0),
    }
    causes += [
        Cause(
            name=f"{name} implausible",
            prepare=_also(_repeated(makers[name], True)),
            act=_also(_repeated(make, True)),
            not_before_s=2.7,
            within_s=4.0,
            **common,
        )
        for name, make in wrong.items()
    ]
    dropped = Cause(
        name="power monitor silent",
        act=lambda world: setattr(world, "drop", (PowerSample,)),
        not_before_s=2.7,
        within_s=4.0,
        **common,
    )
    return [*causes, dropped]


def _battery(rule: Failsafe, share: str, volts: str, quantity: str) -> list[Cause]:
    """By its share and by its voltage, each alone."""
    sag = {volts: 17.0, "BATT_LOW_TIMER": 2.0}
    return [
        Cause(rule=rule, name="share", quantity="remaining", act=_set(remaining=0.19), params={share: 0.2}),
        Cause(
            rule=rule,
            name="voltage",
            quantity=quantity,
            act=_set(voltage_v=16.9),
            params=sag,
            not_before_s=1.9,
            within_s=3.0,
        ),
    ]


def _beyond(rule: Failsafe, by_m: float) -> list[Cause]:
    fence: dict[str, Any] = {"prepare": _fly}
    deep = _nav(pos_ned_m=lambda pos: _at(pos, 2, 1.2 + by_m))
    wall = _nav(pos_ned_m=lambda pos: _at(pos, 1, 1.5 - 0.3 + by_m))
    high = _nav(pos_ned_m=lambda pos: _at(pos, 2, -by_m))  # no higher than it floats: out of the water
    band = {"DEPTH_MAX": 1.2, "DEPTH_MIN": 0.3}
    common: dict[str, Any] = {"rule": rule, "quantity": "beyond_m", "not_before_s": 0.4, "within_s": 1.5}
    return [
        Cause(name="too deep", act=deep, params=band, **common),
        Cause(name="too high", act=high, params=band, **common),
        Cause(name="fence", act=wall, **fence, **common),
    ]


def _invalid(world: CauseWorld) -> None:
    world.answer(lambda nav: replace(nav, health=NavHealth.INVALID))


def _shadow(world: CauseWorld) -> None:
    class Apart:
        disagrees = True

    world.nav.fields["shadow"] = Apart()


CAUSES: tuple[Cause, ...] = (
    Cause(
        rule=Failsafe.NAV_LOST, name="invalid", quantity="nav_lost", act=_invalid, not_before_s=1.9, within_s=3.0,
        params={"FS_NAV_TIMEOUT": 2.0},
    ),
    Cause(
        rule=Failsafe.SOLVER, name="residual", quantity="solver_failures", act=_failing, not_before_s=1.9, within_s=3.0
    ),
    *_battery(Failsafe.BATTERY, "FS_BATT_LOW", "BATT_LOW_VOLT", "low_voltage"),
    *_battery(Failsafe.BATTERY_CRITICAL, "FS_BATT_CRT", "BATT_CRT_VOLT", "critical_voltage"),
    Cause(
        rule=Failsafe.AHRS_STALE, name="silent", quantity="ahrs_age_s", not_before_s=0.4,
        act=lambda world: setattr(world, "drop", (AhrsSample,)),
    ),
    Cause(
        rule=Failsafe.AHRS_STALE, name="frozen", quantity="ahrs_age_s", act=_frozen_ahrs, not_before_s=0.4, within_s=2.0
    ),
    Cause(
        rule=Failsafe.THRUSTER, name="written off", quantity="thruster_problem", not_before_s=2.9, within_s=4.0,
        act=lambda world: [world.params.set(f"THR{n}_HEALTH", 0.0) for n in (1, 2, 3)] and None,
    ),
    Cause(
        rule=Failsafe.THRUSTER, name="device gone", quantity="thruster_problem", not_before_s=2.5, within_s=5.0,
        act=_inputs(troubles=(DeviceTrouble(t_us=0, device=DeviceRole.THRUSTERS, text="gone"),)),
    ),
    Cause(rule=Failsafe.LATENCY, name="late", quantity="command_delay_s", act=_late),
    Cause(rule=Failsafe.NAV_CHECK, name="shadow", quantity="nav_disagrees", act=_shadow),
    Cause(rule=Failsafe.FAULT, name="exception", quantity="fault", act=_broken),
    Cause(
        rule=Failsafe.GCS, name="silent", quantity="gcs_us", not_before_s=1.9, within_s=3.0,
        params={"FS_GCS_TIMEOUT": 2.0, "FS_GCS_ENABLE": 1.0},
        prepare=lambda world: setattr(world, "rx", lambda t: (world.pack(HEARTBEAT),) if t % 500_000 == 0 else ()),
        act=lambda world: setattr(world, "rx", lambda _: ()),
    ),
    Cause(
        rule=Failsafe.PILOT, name="silent", quantity="pilot_us", not_before_s=1.9, within_s=3.0,
        params={"FS_PILOT_TIMEOUT": 2.0},
        act=lambda world: world.tick([world.pack(mav.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0))]) and None,
    ),
    Cause(
        rule=Failsafe.DEAD_RECKONING, name="no fix", quantity="no_fix_s", not_before_s=1.8, within_s=3.0,
        params={"FS_DR_TIME": 2.0}, act=_nav(health=lambda _: NavHealth.DEAD_RECKONING),
    ),
    *_silent(),
    *(
        Cause(
            rule=Failsafe.DOUBT, name=doubt.name, quantity="nav_doubts", not_before_s=0.9, within_s=2.0,
            act=lambda world, doubt=doubt: world.nav.fields.update(doubts=frozenset({doubt})),  # type: ignore[misc]
        )
        for doubt in sorted(_DOUBTS, key=str)
    ),
    Cause(
        rule=Failsafe.ENERGY, name="rest of the plan", quantity="energy_lack", not_before_s=15.0, within_s=30.0,
        params={"THR_DETECT": 0.0, "LAT_DETECT": 0.0},
        prepare=_fly, act=_on_mission,
    ),
    Cause(
        rule=Failsafe.LEAK, name="wet", quantity="wet_us",
        act=_also(lambda t_us: (LeakSample(t_us=t_us, wet=True),)),
    ),
    Cause(
        rule=Failsafe.PRESSURE, name="high", quantity="hull_pa", not_before_s=1.9, within_s=3.0,
        act=_also(lambda t_us: (HullSample(t_us=t_us, pressure_pa=105_001.0, temperature_c=None),)),
    ),
    Cause(
        rule=Failsafe.TEMPERATURE, name="hot", quantity="hull_c", not_before_s=1.9, within_s=3.0,
        act=_also(lambda t_us: (HullSample(t_us=t_us, pressure_pa=None, temperature_c=62.1),)),
    ),
    *_beyond(Failsafe.CAGE_SOFT, 0.2),
    *_beyond(Failsafe.CAGE_HARD, 0.55),
    *(
        Cause(
            rule=Failsafe.TILT, name=name, quantity="tilt_deg", not_before_s=1.9, within_s=3.0,
            act=_nav(rpy_rad=lambda rpy, place=place, sign=sign: _at(rpy, place, sign * math.radians(31.0))),  # type: ignore[misc]
        )
        for name, place, sign in (("port", 0, -1), ("starboard", 0, 1), ("bow up", 1, 1), ("bow down", 1, -1))
    ),
    Cause(rule=Failsafe.COLLISION, name="jolt", quantity="collided_us", act=_jolt),
    Cause(
        rule=Failsafe.STUCK, name="held", quantity="stuck_s", not_before_s=1.9, within_s=15.0,
        params={"FS_STUCK_TIME": 2.0}, prepare=_fly, act=_went,
    ),
    Cause(
        rule=Failsafe.TETHER, name="distance", quantity="tether_m", params={"TETHER_LEN": 1.0},
        act=_nav(pos_ned_m=lambda pos: _at(pos, 0, 1.1)),
    ),
    Cause(
        rule=Failsafe.TETHER, name="way", quantity="tether_m", not_before_s=1.0, within_s=30.0,
        params={"TETHER_LEN": 1.0, "TETHER_COUNT": 1.0}, act=_wander,
    ),
    Cause(
        rule=Failsafe.LOOP, name="late ticks", quantity="late_fraction", act=_overload, not_before_s=2.9, within_s=6.0,
    ),
    Cause(
        rule=Failsafe.CAMERA, name="not believed", quantity="nav_doubts",
        act=lambda world: world.nav.fields.update(doubts=frozenset({NavDoubt.CAMERA})),
    ),
    Cause(
        rule=Failsafe.SENDER, name="rival", quantity="rival",
        prepare=_inputs(below=FlightControllerState(t_us=0, authority=Authority.OURS, acts=True, armed=True)),
        act=_inputs(below=FlightControllerState(t_us=0, authority=Authority.OURS, acts=True, armed=True, rival=True)),
    ),
    Cause(
        rule=Failsafe.WATCHDOG, name="ended", quantity="watchdog_problem", not_before_s=2.9, within_s=4.0,
        act=_inputs(troubles=(DeviceTrouble(t_us=0, device=DeviceRole.WATCHDOG, text="has ended"),)),
    ),
    Cause(rule=Failsafe.LOG, name="lost", quantity="log_lost", act=_inputs(log_lost=True)),
    *(
        Cause(
            rule=Failsafe.CLOCK, name=f"{jump_s:+.1f} s", quantity="jumped_us",
            act=_inputs(clock_jump_s=jump_s),
        )
        for jump_s in (0.5, -0.5, 3600.0)
    ),
    Cause(
        rule=Failsafe.ASCENT, name="blind", quantity="blind_s", not_before_s=3.5, within_s=8.0,
        params={"FS_ASCENT_TIME": 2.0, "FS_NAV_TIMEOUT": 2.0}, act=_invalid,
    ),
)  # fmt: skip

PLUMBING = {"v", "f", "power", "t_us", "min", "max", "_age", "_NAN", "_DOUBTS", "isdisjoint", "armed_us"}
PLUMBING |= {"below", "float", "NavDoubt", "CAMERA"}
PLUMBING |= {"VEHICLE_STATUS", "latched_us", "shown_us"}


def test_every_quantity_that_a_row_looks_at_has_a_cause_here() -> None:
    for row in ROWS:
        looked_at = set(row.level.__code__.co_names) - PLUMBING
        assert looked_at, row.rule
        tried = {cause.quantity for cause in CAUSES if cause.rule is row.rule}
        assert looked_at == tried, f"{row.rule.name}: write a Cause for {sorted(looked_at ^ tried)}"


def _row(rule: Failsafe) -> FailsafeRow:
    return next(row for row in ROWS if row.rule is rule)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: f"{cause.rule.name}-{cause.name}")
def test_a_cause_raises_its_row_in_its_time_and_is_told(cause: Cause) -> None:
    row, bit = _row(cause.rule), 1 << cause.rule
    chosen = {row.action: 1.0 if row.effects[0] == "off" else 0.0} if row.action else {}
    world = CauseWorld({**chosen, **cause.params})
    cause.prepare(world)
    world.take_off()
    world.run(1.0)
    assert not world.bits & bit, "not without its cause"
    world.inbox.clear()
    cause.act(world)
    begun: int | None = None
    for tick in range(round(cause.within_s * 100)):
        if world.tick().mode.failsafes & bit:
            begun = tick
            break
    assert begun is not None, f"not within {cause.within_s} s"
    assert begun >= 100 * cause.not_before_s - 1, f"after {begun * 0.01:.2f} s"
    world.run(0.3)
    assert "Failsafe: " in world.texts() or RANK[row.effects[int(chosen.get(row.action, 0.0))]] > 0
    assert world.t_us % TICK_US == 0
