"""Figures of the energy benchmark: ways over the flow beside the optimum, and energies."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.bench.energy.cases import CASES, CYLINDERS, REGION_M, TANK_X_M, TANK_Y_M, Case
from autopilot.bench.energy.flight import EnergyFlight
from autopilot.bench.energy.record import CORRIDOR_LAPS, Record, comparator, load_records

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#999999")
"""Okabe and Ito, safe for the colour-blind."""

DPI = 110


def draw(flights: Sequence[EnergyFlight], folder: str) -> list[str]:
    """Write ``energy_CASE.png`` for every case that was flown and ``energy_bars.png``; the result is their paths."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    target, records = Path(folder), load_records()
    target.mkdir(parents=True, exist_ok=True)
    written = []
    for name in dict.fromkeys(flight.case for flight in flights):
        figure, axes = plt.subplots(figsize=(8.0, 6.0), constrained_layout=True)
        _map(
            axes,
            CASES[name],
            records[CORRIDOR_LAPS if name == "b1" else name],
            [flight for flight in flights if flight.case == name],
        )
        path = target / f"energy_{name.replace(' ', '_').replace('@', '_')}.png"
        figure.savefig(path, dpi=DPI)
        plt.close(figure)
        written.append(str(path))
    figure, axes = plt.subplots(figsize=(9.0, 0.35 * len(flights) + 1.5), constrained_layout=True)
    _bars(axes, flights, records)
    path = target / "energy_bars.png"
    figure.savefig(path, dpi=DPI)
    plt.close(figure)
    return [*written, str(path)]


def _map(axes: Any, case: Case, record: Record, flights: Sequence[EnergyFlight]) -> None:
    """East to the right, north up."""
    everything = np.vstack([record.track_ned_m, *(flight.track for flight in flights)])
    low, high = everything.min(axis=0) - 1.5, everything.max(axis=0) + 1.5
    if case.tank:
        low, high = np.array([-TANK_X_M, -TANK_Y_M]), np.array([TANK_X_M, TANK_Y_M])
    north, east = np.meshgrid(np.linspace(low[0], high[0], 21), np.linspace(low[1], high[1], 21), indexing="ij")
    flow = np.broadcast_arrays(*case.flow(north, east, np))
    if max(float(np.abs(part).max()) for part in flow) > 0.0:
        axes.quiver(east, north, flow[1], flow[0], color="0.6", width=0.003, scale=5.0)
    if case.tank:
        from matplotlib.patches import Circle

        for x, y, radius in CYLINDERS:
            axes.add_patch(Circle((y, x), radius, color="0.4"))
    for index, flight in enumerate(flights):
        again, place = divmod(index, len(COLOURS))
        style = "-." if again else "-"
        axes.plot(flight.track[:, 1], flight.track[:, 0], style, color=COLOURS[place], lw=1.2, label=flight.pilot)
    axes.plot(
        record.track_ned_m[:, 1],
        record.track_ned_m[:, 0],
        "k--",
        lw=1.8,
        label=f"optimum {record.energy_j / len(record.lap_j):.0f} J",
    )
    for goal in case.goals:
        angle = np.linspace(0.0, 2.0 * np.pi, 60)
        east_m, north_m = goal.pos_ned_m[1] + REGION_M * np.sin(angle), goal.pos_ned_m[0] + REGION_M * np.cos(angle)
        axes.plot(east_m, north_m, "k:", lw=1.0)
    axes.set(xlabel="east [m]", ylabel="north [m]", title=case.name, aspect="equal")
    axes.set_xlim(low[1], high[1])
    axes.set_ylim(low[0], high[0])
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.02, 0.5))


def _bars(axes: Any, flights: Sequence[EnergyFlight], records: dict[str, Record]) -> None:
    """Energy per lap over that of the optimum with the same freedom."""
    others = [comparator(records, each.case, each.laps, each.corridor, each.drag) for each in flights]
    ratios = [flight.lap_j / other.lap_j for flight, other in zip(flights, others, strict=True)]
    finite = [ratio if np.isfinite(ratio) else 0.0 for ratio in ratios]
    labels = [f"{flight.case}: {flight.pilot}" for flight in flights]
    places = np.arange(len(flights))
    axes.barh(places, finite, color=COLOURS[0])
    axes.axvline(1.0, color="k", ls="--", lw=1.0)
    for place, ratio in zip(places, ratios, strict=True):
        text = f"{ratio:.3f}" if np.isfinite(ratio) else "not reached"
        axes.text(0.02, place, text, va="center", color="w" if np.isfinite(ratio) else "k", fontsize=8)
    axes.set_yticks(places, labels, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("energy per lap / optimum")
