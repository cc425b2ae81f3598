"""``autopilot bench energy``: the controller beside the optimum (rivals: ``autopilot bench energy-rivals``)."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from autopilot.control.current.current_learning import EstimatedFlow
from autopilot.core.vehicle import Vehicle, load_vehicle
from tests.bench.energy.cases import CASES
from tests.bench.energy.flight import ENERGY_PARAMS, EnergyFlight, fly, nmpc_pilot
from tests.bench.energy.record import DRAGS, Record, comparator, load_records
from tests.bench.energy.service_flight import fly_service

KNOWN, ESTIMATED = (1.05, 1.02), (1.12, 1.06)
"""Bar and goal, flow known and flow estimated."""
SHORT_CASES = ("b1", "b5")
SERVICE_CASES = {"b1": "b1-est", "b2 0.15@60": "b2-est", "b3 up": "b3-est", "b4": "b4-est", "b5": "b5-est"}
FELT_CASES = ("b3 up", "b4", "b5")
"""Flown too with the flow known only where the vehicle is, exactly; and once more with what the first flight taught."""
SECOND_FLIGHT_US = 200_000_000
"""When it begins."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyRow:
    """One flight beside the optimum with the same freedom."""

    case: str
    pilot: str
    finished: bool
    lap_j: float
    """Mean of the laps."""
    against: str
    """What it is compared with: see :func:`tests.bench.energy.record.comparator`."""
    against_j: float
    """Of its laps."""
    ratio: float
    bar: float
    goal: float
    kept: bool
    """The bar."""
    nearest_m: float | None
    top_m_s: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EnergyResult:
    """Rows of the table and what was flown."""

    rows: list[EnergyRow]
    flights: list[EnergyFlight]


def bench_energy(
    short: bool = False, progress: Callable[[str], None] = lambda _: None, cases: Sequence[str] = ()
) -> EnergyResult:
    """Every row; ``short``: B1 in one lap, B5. ``cases``: only theirs."""
    vehicle, records = load_vehicle("lbv150"), load_records()
    rows: list[EnergyRow] = []
    flights: list[EnergyFlight] = []
    for flight, (bar, goal) in _flights(vehicle, short, tuple(cases) or (SHORT_CASES if short else tuple(CASES))):
        flights.append(flight)
        rows.append(against_optimum(flight, bar, goal, records))
        progress(f"{flight.case}, {flight.pilot}: {rows[-1].lap_j:.1f} J, {rows[-1].ratio:.3f} of {rows[-1].against}")
    return EnergyResult(rows=rows, flights=flights)


def _flights(vehicle: Vehicle, short: bool, names: Sequence[str]) -> Iterator[tuple[EnergyFlight, tuple[float, float]]]:
    """Flights of some cases with bar and goal, B1 first."""
    for name in sorted(names, key=list(CASES).index):
        case = CASES[name]
        pilot = nmpc_pilot(vehicle, case, ENERGY_PARAMS)
        yield fly(case, pilot, "energy, flow known", vehicle, laps=1 if short else 0), KNOWN
        if case.tank:
            again = nmpc_pilot(vehicle, case, ENERGY_PARAMS)
            fenced = "energy, flow known, corridor fenced off"
            yield fly(case, again, fenced, vehicle, laps=1 if short else 0, corridor=False), KNOWN
    for name in () if short else [name for name in FELT_CASES if name in names]:
        case, flow = CASES[name], EstimatedFlow()
        for number, label in enumerate(("energy, flow felt", "energy, flow felt, second flight")):
            pilot = nmpc_pilot(vehicle, case, ENERGY_PARAMS, flow)
            yield fly(case, pilot, label, vehicle, clock_us=number * SECOND_FLIGHT_US), ESTIMATED
    for name, scenario in () if short else [row for row in SERVICE_CASES.items() if row[0] in names]:
        for currents in ("estimate", "map"):
            for drag in DRAGS:
                yield fly_service(CASES[name], scenario, drag, currents), ESTIMATED


def against_optimum(flight: EnergyFlight, bar: float, goal: float, records: dict[str, Record]) -> EnergyRow:
    """A flight beside the optimum with its freedom."""
    other = comparator(records, flight.case, flight.laps, flight.corridor, flight.drag)
    ratio = flight.lap_j / other.lap_j
    return EnergyRow(
        case=flight.case,
        pilot=flight.pilot,
        finished=flight.finished,
        lap_j=flight.lap_j,
        against=other.name,
        against_j=other.lap_j,
        ratio=ratio,
        bar=bar,
        goal=goal,
        kept=ratio <= bar,
        nearest_m=None if math.isinf(flight.nearest_m) else flight.nearest_m,
        top_m_s=flight.top_m_s,
    )
