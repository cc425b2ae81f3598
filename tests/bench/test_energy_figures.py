"""Figures of the energy benchmark: what a reader sees of many flights."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.bench.energy.figures import GROUPS, draw, group_of
from tests.bench.energy.flight import EnergyFlight
from tests.bench.energy.record import CORRIDOR_LAPS, load_records

PILOTS = {
    "energy, flow known, corridor fenced off": "least energy, flow known",
    "service, map, drag 1.2": "least energy, flow known",
    "energy, flow felt, second flight": "least energy, flow felt",
    "service, estimate, drag 0.8": "least energy, flow estimated",
}


def flight(pilot: str, factor: float) -> EnergyFlight:
    record = load_records()[CORRIDOR_LAPS]
    legs = tuple(factor * joules for joules in record.leg_j)
    return EnergyFlight(
        case="b1",
        pilot=pilot,
        finished=math.isfinite(factor),
        energy_j=sum(legs),
        leg_j=legs,
        leg_s=(1.0,) * len(legs),
        nearest_m=0.0,
        top_m_s=0.5,
        track=record.track_ned_m + np.array([0.01 * factor, 0.0]) if math.isfinite(factor) else record.track_ned_m,
        laps=3,
    )


@pytest.mark.parametrize(("pilot", "group"), list(PILOTS.items()))
def test_flights_have_the_colour_of_what_they_knew(pilot: str, group: str) -> None:
    assert group_of(flight(pilot, 1.0)).name == group


def test_figures_are_drawn(tmp_path: Path) -> None:
    flights = [flight(pilot, 1.0 + 0.1 * number) for number, pilot in enumerate(PILOTS)]
    written = draw([*flights, flight("energy, flow known", math.inf)], str(tmp_path))
    assert [Path(path).name for path in written] == ["energy_b1.png", "energy_bars.png"]
    bars = cv2.imread(written[1])
    for name in PILOTS.values():
        colour = next(group.colour for group in GROUPS if group.name == name)
        bgr = [int(colour[at : at + 2], 16) for at in (5, 3, 1)]
        assert (bars == bgr).all(axis=2).sum() > 500, name
