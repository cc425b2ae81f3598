"""Figures of the energy benchmark: ways over the flow beside the optimum, and energies."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.bench.energy.cases import CASES, CYLINDERS, REGION_M, TANK_X_M, TANK_Y_M, Case
from autopilot.bench.energy.flight import EnergyFlight
from autopilot.bench.energy.record import CORRIDOR_LAPS, Record, comparator, load_records


@dataclass(frozen=True, slots=True)
class Group:
    """Flights whose pilots knew the same: one colour in every figure (Okabe and Ito, safe for the colour-blind)."""

    name: str
    words: tuple[str, ...]
    """One of them is in the names of its pilots."""
    colour: str


GROUPS = (
    Group("least energy, flow known", ("flow known", "map"), "#0072B2"),
    Group("least energy, flow felt", ("flow felt",), "#56B4E9"),
    Group("least energy, flow estimated", ("estimate",), "#009E73"),
    Group("quadratic mode", ("quadratic",), "#E69F00"),
    Group("knows nothing of the current", ("current-unaware",), "#CC79A7"),
    Group("line of sight with PID", ("line of sight",), "#D55E00"),
    Group("other", ("",), "#999999"),
)
STYLES = ("-", (0, (6, 1.5)), (0, (1.5, 1)), "-.", (0, (6, 1.5, 1, 1.5, 1, 1.5)))
"""Of the flights of one group in a map, in order."""
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
    figure, axes = plt.subplots(
        figsize=(9.5, 0.3 * (len(flights) + len(_by_case(flights))) + 1.2), constrained_layout=True
    )
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
    axes.plot(
        record.track_ned_m[:, 1],
        record.track_ned_m[:, 0],
        "k--",
        lw=1.8,
        label=f"optimum: {record.energy_j / len(record.lap_j):.0f} J",
    )
    shown: dict[str, int] = {}
    for flight in sorted(flights, key=lambda flight: GROUPS.index(group_of(flight))):
        group = group_of(flight)
        style = STYLES[min(shown.get(group.name, 0), len(STYLES) - 1)]
        shown[group.name] = shown.get(group.name, 0) + 1
        energy = f"{flight.lap_j:.0f} J" if flight.finished else "not reached"
        axes.plot(
            flight.track[:, 1],
            flight.track[:, 0],
            ls=style,
            color=group.colour,
            lw=1.2,
            label=f"{flight.pilot}: {energy}",
        )
    for goal in case.goals:
        angle = np.linspace(0.0, 2.0 * np.pi, 60)
        east_m, north_m = goal.pos_ned_m[1] + REGION_M * np.sin(angle), goal.pos_ned_m[0] + REGION_M * np.cos(angle)
        axes.plot(east_m, north_m, "k:", lw=1.0)
    axes.set(xlabel="east [m]", ylabel="north [m]", title=case.name, aspect="equal")
    axes.set_xlim(low[1], high[1])
    axes.set_ylim(low[0], high[0])
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.02, 0.5))


def group_of(flight: EnergyFlight) -> Group:
    """What the pilot of a flight knew; the first group that its name speaks of."""
    return next(group for group in GROUPS if any(word in flight.pilot for word in group.words))


def _by_case(flights: Sequence[EnergyFlight]) -> dict[str, list[EnergyFlight]]:
    found: dict[str, list[EnergyFlight]] = {}
    for flight in flights:
        found.setdefault(flight.case, []).append(flight)
    return found


def _bars(axes: Any, flights: Sequence[EnergyFlight], records: dict[str, Record]) -> None:
    """Energy per lap over that of the optimum with the same freedom: a block per case, a colour per group."""
    from matplotlib.patches import Patch

    place, places, labels, right = 0.0, [], [], 1.0
    for case, mine in _by_case(flights).items():
        axes.text(0.0, place, CASES[case].name, va="center", ha="left", fontsize=9, fontweight="bold")
        place += 1.0
        for flight in sorted(mine, key=lambda flight: GROUPS.index(group_of(flight))):
            other = comparator(records, flight.case, flight.laps, flight.corridor, flight.drag)
            ratio = flight.lap_j / other.lap_j
            arrived = bool(np.isfinite(ratio))
            axes.barh(place, ratio if arrived else 0.0, height=0.8, color=group_of(flight).colour)
            text = f"{ratio:.2f}: {flight.lap_j:.0f} of {other.lap_j:.0f} J" if arrived else "not reached"
            axes.text((ratio if arrived else 0.0) + 0.01, place, text, va="center", fontsize=8)
            right = max(right, ratio) if arrived else right
            places.append(place)
            labels.append(flight.pilot)
            place += 1.0
    axes.axvline(1.0, color="k", ls="--", lw=1.0)
    axes.set_yticks(places, labels, fontsize=8)
    axes.set_xlim(0.0, 1.25 * right)
    axes.set_ylim(place - 0.3, -0.7)
    axes.set_xlabel("energy per lap / that of the optimum with the same freedom (dashed: 1)")
    used = [group for group in GROUPS if any(group_of(flight) is group for flight in flights)]
    axes.legend(
        handles=[Patch(color=group.colour, label=group.name) for group in used],
        fontsize=8,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=min(3, len(used)),
        frameon=False,
    )
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
