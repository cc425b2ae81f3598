"""``autopilot bench energy``: the controller beside the optimum and beside its rivals."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from autopilot.bench.energy.cases import CASES
from autopilot.bench.energy.flight import ENERGY_PARAMS, QUADRATIC_PARAMS, Flight, fly, los_pilot, nmpc_pilot
from autopilot.bench.energy.los_pid import LosGains
from autopilot.bench.energy.record import CORRIDOR, DRAGS, Record, load_records
from autopilot.bench.energy.service_flight import fly_service
from autopilot.control.currents import NoCurrent
from autopilot.core.vehicle import Vehicle, load_vehicle

KNOWN_BAR, ESTIMATED_BAR = 1.05, 1.12
CRUISES_M_S = (0.2, 0.25, 0.3, 0.35)
"""Cruise speeds that the quadratic controller is tried with; the best counts."""

SERVICE_CASES = {"b1": "b1-est", "b2 0.15@60": "b2-est", "b3 up": "b3-est", "b4": "b4-est", "b5": "b5-est"}
RIVAL_BARS = {
    "quadratic": 0.60,
    "current-unaware": 0.55,
    "PID line of sight": 0.70,
    "quadratic, cruise as shipped": 0.60,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyRow:
    """One flight."""

    case: str
    pilot: str
    finished: bool
    lap_j: float
    """Per lap."""
    reference_j: float
    """What it is compared with: the optimum, or the rival."""
    ratio: float
    bar: float
    published_ratio: float | None
    """Against the published optimum, of a vehicle that neither floats nor sinks: the stricter figure."""
    corridor_ratio: float | None
    """Against the published optimum with the south corridor open, without buoyancy too."""
    flown_ratio: float | None
    """Where the model is wrong: against the optimum of the vehicle that is flown, not of the nominal one."""
    nearest_m: float | None
    top_m_s: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EnergyResult:
    """Rows of the table and what was flown."""

    rows: list[EnergyRow]
    flights: list[Flight]


def bench_energy(short: bool = False, progress: Callable[[str], None] = lambda _: None) -> EnergyResult:
    """Every row; ``short``: B1 with its rivals in one lap, B5."""
    vehicle, records = load_vehicle("lbv150"), load_records()
    rows: list[EnergyRow] = []
    flights: list[Flight] = []
    for flight, bar, drag in _flights(vehicle, short):
        flights.append(flight)
        rows.append(_against_optimum(flight, bar, drag, records))
        progress(f"{flight.case}, {flight.pilot}: {rows[-1].lap_j:.1f} J, {rows[-1].ratio:.3f}")
    own = flights[0]
    for rival in _rivals(vehicle, laps=len(own.leg_j) // 2):
        flights.append(rival)
        rows.append(_against_rival(own, rival))
        progress(f"{rival.case}, energy / {rival.pilot}: {rows[-1].ratio:.3f}")
    return EnergyResult(rows=rows, flights=flights)


def _flights(vehicle: Vehicle, short: bool) -> Iterator[tuple[Flight, float, float | None]]:
    """Flights, their bars, and the factor on drag where the model is wrong."""
    for name in ("b1", "b5") if short else CASES:
        case = CASES[name]
        pilot = nmpc_pilot(vehicle, case, ENERGY_PARAMS)
        yield fly(case, pilot, "energy, flow known", vehicle, laps=1 if short else 0), KNOWN_BAR, None
        if case.tank:
            again = nmpc_pilot(vehicle, case, ENERGY_PARAMS)
            fenced = "energy, flow known, corridor fenced off"
            yield fly(case, again, fenced, vehicle, laps=1 if short else 0, corridor=False), KNOWN_BAR, None
    for name, scenario in {} if short else SERVICE_CASES.items():
        for currents in ("estimate", "map"):
            for drag in DRAGS:
                yield fly_service(CASES[name], scenario, drag, currents), ESTIMATED_BAR, drag


def _rivals(vehicle: Vehicle, laps: int) -> list[Flight]:
    """The best of each kind on B1, over as many laps; and the quadratic one at the speed that nobody has tuned."""
    case = CASES["b1"]
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


def _best(flights: list[Flight]) -> Flight:
    return min(flights, key=lambda flight: flight.energy_j if flight.finished else math.inf)


def lap_energy_j(flight: Flight) -> float:
    """Mean over the laps that were flown, inf if none was."""
    goals = len(CASES[flight.case].goals)
    laps = len(flight.leg_j) // goals
    return sum(flight.leg_j[: laps * goals]) / laps if laps else math.inf


def _against_optimum(flight: Flight, bar: float, drag: float | None, records: dict[str, Record]) -> EnergyRow:
    record, lap_j = records[flight.case], lap_energy_j(flight)
    corridor = lap_j / records[CORRIDOR].published_j if flight.case == "b1" else None
    published = lap_j / record.published_j
    flown = None if drag is None else lap_j / record.heavier_j[f"{drag:g}"]
    return _row(
        flight, lap_j, record.energy_j, bar, published_ratio=published, corridor_ratio=corridor, flown_ratio=flown
    )


def _against_rival(own: Flight, rival: Flight) -> EnergyRow:
    reference_j = lap_energy_j(rival)
    return _row(rival, lap_energy_j(own), reference_j, RIVAL_BARS[rival.pilot])


def _row(
    flight: Flight,
    lap_j: float,
    reference_j: float,
    bar: float,
    *,
    published_ratio: float | None = None,
    corridor_ratio: float | None = None,
    flown_ratio: float | None = None,
) -> EnergyRow:
    rival = flight.pilot in RIVAL_BARS
    return EnergyRow(
        case=flight.case,
        pilot=f"energy / {flight.pilot}" if rival else flight.pilot,
        finished=flight.finished,
        lap_j=lap_j,
        reference_j=reference_j,
        ratio=lap_j / reference_j if flight.finished else math.inf,
        bar=bar,
        published_ratio=published_ratio,
        corridor_ratio=corridor_ratio,
        flown_ratio=flown_ratio,
        nearest_m=None if math.isinf(flight.nearest_m) else flight.nearest_m,
        top_m_s=flight.top_m_s,
    )
