"""``autopilot bench energy``: the controller beside the optimum and beside its rivals."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from autopilot.control.current.current_learning import EstimatedFlow
from autopilot.control.current.currents import NoCurrent
from autopilot.core.vehicle import Vehicle, load_vehicle
from tests.bench.energy.cases import CASES
from tests.bench.energy.flight import ENERGY_PARAMS, QUADRATIC_PARAMS, EnergyFlight, fly, los_pilot, nmpc_pilot
from tests.bench.energy.los_pid import LosGains
from tests.bench.energy.record import DRAGS, Record, comparator, load_records
from tests.bench.energy.service_flight import fly_service

KNOWN, ESTIMATED = (1.05, 1.02), (1.12, 1.06)
"""Bar and goal, flow known and flow estimated."""
CRUISES_M_S = (0.2, 0.25, 0.3, 0.35)
"""Cruise speeds that the quadratic controller is tried with; the best counts."""

SHORT_CASES = ("b1", "b5")
RIVAL_CASE = "b1"
"""What the rivals fly."""

SERVICE_CASES = {"b1": "b1-est", "b2 0.15@60": "b2-est", "b3 up": "b3-est", "b4": "b4-est", "b5": "b5-est"}
FELT_CASES = ("b3 up", "b4", "b5")
"""Flown too with the flow known only where the vehicle is, exactly; and once more with what the first flight taught."""
SECOND_FLIGHT_US = 200_000_000
"""When it begins."""

RIVAL_BARS = {
    "quadratic": 0.60,
    "current-unaware": 0.55,
    "PID line of sight": 0.70,
    "quadratic, cruise as shipped": 0.60,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyRow:
    """One flight beside one other: the optimum with the same freedom, or a rival."""

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
    goal: float | None
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
    """Every row; ``short``: B1 with its rivals in one lap, B5. ``cases``: only theirs."""
    vehicle, records = load_vehicle("lbv150"), load_records()
    rows: list[EnergyRow] = []
    flights: list[EnergyFlight] = []
    for flight, (bar, goal) in _flights(vehicle, short, tuple(cases) or (SHORT_CASES if short else tuple(CASES))):
        flights.append(flight)
        rows.append(against_optimum(flight, bar, goal, records))
        progress(f"{flight.case}, {flight.pilot}: {rows[-1].lap_j:.1f} J, {rows[-1].ratio:.3f} of {rows[-1].against}")
    own = flights[0]
    for rival in _rivals(vehicle, laps=own.laps) if own.case == RIVAL_CASE else ():
        flights.append(rival)
        rows.append(_against_rival(own, rival))
        progress(f"{rival.case}, energy / {rival.pilot}: {rows[-1].ratio:.3f}")
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


def _rivals(vehicle: Vehicle, laps: int) -> list[EnergyFlight]:
    """The best of each kind on B1, over as many laps; and the quadratic one at the speed that nobody has tuned."""
    case = CASES[RIVAL_CASE]
    quadratic = [
        fly(case, nmpc_pilot(vehicle, case, QUADRATIC_PARAMS), "quadratic", vehicle, cruise_m_s=cruise, laps=laps)
        for cruise in CRUISES_M_S
    ]
    unaware = [
        fly(
            case,
            nmpc_pilot(vehicle, case, QUADRATIC_PARAMS, NoCurrent()),
            "current-unaware",
            vehicle,
            cruise_m_s=cruise,
            laps=laps,
        )
        for cruise in CRUISES_M_S
    ]
    shipped = fly(case, nmpc_pilot(vehicle, case, QUADRATIC_PARAMS), "quadratic, cruise as shipped", vehicle, laps=laps)
    pid = fly(case, los_pilot(vehicle, LosGains()), "PID line of sight", vehicle, laps=laps)
    return [_best(quadratic), _best(unaware), pid, shipped]


def _best(flights: list[EnergyFlight]) -> EnergyFlight:
    return min(flights, key=lambda flight: flight.energy_j if flight.finished else math.inf)


def against_optimum(flight: EnergyFlight, bar: float, goal: float, records: dict[str, Record]) -> EnergyRow:
    """A flight beside the optimum with its freedom."""
    other = comparator(records, flight.case, flight.laps, flight.corridor, flight.drag)
    return _row(flight, flight.pilot, flight, other.name, other.lap_j, bar, goal)


def _against_rival(own: EnergyFlight, rival: EnergyFlight) -> EnergyRow:
    return _row(rival, "energy, flow known", own, rival.pilot, rival.lap_j, RIVAL_BARS[rival.pilot], None)


def _row(
    shown: EnergyFlight, pilot: str, flown: EnergyFlight, against: str, against_j: float, bar: float, goal: float | None
) -> EnergyRow:
    """Energy of ``flown``; clearance and speed of ``shown``. A rival that has not arrived proves nothing."""
    ratio = flown.lap_j / against_j if shown.finished else math.inf
    return EnergyRow(
        case=shown.case,
        pilot=pilot,
        finished=shown.finished,
        lap_j=flown.lap_j,
        against=against,
        against_j=against_j,
        ratio=ratio,
        bar=bar,
        goal=goal,
        kept=ratio <= bar,
        nearest_m=None if math.isinf(shown.nearest_m) else shown.nearest_m,
        top_m_s=shown.top_m_s,
    )
