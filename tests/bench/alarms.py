"""Sound vehicles raise no alarm, whether disarmed, holding or flying.

The whole service flies the shipped scenarios whose sensors, thrusters and calibration are sound, in lockstep: a third
of the time disarmed, a third armed and holding, a third on its mission where there is one. Every WARNING and worse
is a false alarm.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from autopilot.core.messages import Event, Outputs, Severity
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl
from autopilot.sitl.operator import ScriptedOperator
from autopilot.sitl.scenario import load_scenario, plan_path

FLIGHTS: tuple[tuple[str, str | None], ...] = (
    ("paper-tank", None),
    ("paper-tank-still", None),
    ("open-water", None),
    ("harbour", None),
    ("vortex", None),
    ("narrow-gap", None),
    ("hand-laid", None),
    ("pool", None),
    ("r1", None),
    ("r2", None),
    ("r3", None),
    ("b1-est", None),
    ("b2-est", None),
    ("b3-est", None),
    ("b4-est", None),
    ("b5-est", None),
    ("b6-est", None),
    ("open-water", "bluerov2"),
    ("open-water", "bluerov2-heavy"),
    ("pool", "bluerov2-heavy"),
)
"""Scenarios and vehicles (None: the scenario's) in which nothing is wrong."""
PHASES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Quiet:
    scenario: str
    vehicle: str
    seed: int
    flown_s: float
    armed_s: float
    alarms: tuple[str, ...]
    """Time, text."""

    @property
    def kept(self) -> bool:
        """Whether nothing was said, and the vehicle was armed at all."""
        return not self.alarms and self.armed_s > 0.0


class PatientOperator(ScriptedOperator):
    """Arms after a while, and begins the mission after as long again."""

    def __init__(self, phase_s: float, *, mission: bool) -> None:
        super().__init__(1)
        self._phase_us = round(1e6 * phase_s)
        self._mission = mission
        self._orders = list(self._todo)
        self._todo = []

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        """One tick: the next order when it is due."""
        ordered = len(self._orders) == 1
        if self._orders and t_us >= (2 if ordered else 1) * self._phase_us and (self._mission or not ordered):
            self._todo.append(self._orders.pop(0))
        return super().step(t_us, received)


def fly_quietly(
    scenario: str, vehicle: str | None, seed: int, duration_s: float, sensors: str = "pose", *, armed: bool = True
) -> Quiet:
    """One flight of so many simulated seconds; not ``armed``: disarmed to the end."""
    plan = plan_path(scenario, load_scenario(scenario)) if armed and vehicle is None else None
    warnings: list[Event] = []
    armed_us, last_us = 0, 0

    def hear(outputs: Outputs) -> None:
        nonlocal armed_us, last_us
        armed_us += (outputs.t_us - last_us) * outputs.mode.armed
        last_us = outputs.t_us
        warnings.extend(event for event in outputs.events if event.severity <= Severity.WARNING)

    with tempfile.TemporaryDirectory(prefix="autopilot-") as name:
        given = {"scenario": scenario, "speed": 0.0, "sensors": sensors, "duration": duration_s, "seed": seed}
        settings = flight_settings(name, {**given, "vehicle": vehicle, "plan": plan and str(plan)})
        operator = PatientOperator(duration_s / PHASES, mission=plan is not None)
        unfenced = {"FENCE_REQUIRED": 0.0} if plan is None else {}
        open_sitl(settings, unfenced, log=False, peers=[operator] if armed else [], on_tick=hear).run()
    alarms = tuple(f"{1e-6 * event.t_us:.1f} s: {event.text}" for event in warnings)
    flown_s, armed_s = 1e-6 * last_us, 1e-6 * armed_us
    return Quiet(scenario=scenario, vehicle=vehicle or "", seed=seed, flown_s=flown_s, armed_s=armed_s, alarms=alarms)


def bench_alarms(seeds: Sequence[int], duration_s: float, sensors: str, only: str | None = None) -> Iterator[Quiet]:
    """All flights with each seed; ``only``: of this scenario."""
    for seed in seeds:
        for scenario, vehicle in FLIGHTS:
            if only in (None, scenario):
                yield fly_quietly(scenario, vehicle, seed, duration_s, sensors)
