"""Figures of the energy benchmark: ways over the flow beside the optimum, and energies."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.frames import FloatArray
from tests.bench.energy.cases import BODY_RADIUS_M, CASES, CYLINDERS, REGION_M, TANK_X_M, TANK_Y_M, Case
from tests.bench.energy.flight import EnergyFlight
from tests.bench.energy.record import Record, comparator, load_records


@dataclass(frozen=True, slots=True)
class Group:
    """Flights whose pilots knew the same: one colour in every figure (Okabe and Ito, safe for the colour-blind)."""

    name: str
    names: tuple[str, ...]
    """One of them is in the names of its pilots."""
    colour: str


GROUPS = (
    Group("least energy, flow known", ("flow known", "map"), "#0072B2"),
    Group("least energy, flow felt", ("flow felt",), "#56B4E9"),
    Group("least energy, flow estimated", ("estimate",), "#009E73"),
    Group("other", ("",), "#999999"),
)
PANELS = (
    ("flow known", ("least energy, flow known",)),
    ("flow felt", ("least energy, flow felt",)),
    ("flow estimated", ("least energy, flow estimated",)),
    ("other", ("other",)),
)
"""Maps beside each other, and whose flights are in each: ten ways in one map hide each other."""
LOOKS: tuple[tuple[str, Any], ...] = tuple(
    zip(
        ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00"),
        ("-", (0, (6, 1.5)), "-.", (0, (3, 1)), (0, (6, 1.5, 1, 1.5))),
        strict=True,
    )
)
"""Colour and line of the flights of one map, in order."""
OPTIMA: tuple[tuple[str, Any], ...] = (
    ("optimum", (0, (4, 2))),
    ("optimum, corridor fenced off", (0, (1, 1.5))),
)
HEIGHT_IN, HEAD_IN, FOOT_IN, SIDE_IN = 7.2, 0.75, 1.7, 0.35
PANEL_IN = (2.7, 4.5)
"""Bounds of a map's width; a legend is as wide as the first."""
ARROWS, LEAST_FRACTION = 16, 0.04
"""Arrows of the current along the longer side, and the share of the fastest that is worth one."""
HEADS, HEAD_FRACTION = 6, 0.02
"""Arrow heads on a lap, and how much of its way one takes."""
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
        figure = _maps(CASES[name], records, [flight for flight in flights if flight.case == name])
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


def _maps(case: Case, records: dict[str, Record], flights: Sequence[EnergyFlight]) -> Any:
    """A figure with a map per panel that has flights of this case."""
    import matplotlib.pyplot as plt

    panels = [
        (title, found) for title, groups in PANELS if (found := [f for f in flights if group_of(f).name in groups])
    ]
    low, high = _extent(case, records, flights)
    height = HEIGHT_IN - HEAD_IN - FOOT_IN
    width = min(max(height * (high[1] - low[1]) / (high[0] - low[0]), PANEL_IN[0]), PANEL_IN[1])
    figure, row = plt.subplots(
        1,
        len(panels),
        figsize=(len(panels) * (width + SIDE_IN) + SIDE_IN, HEIGHT_IN),
        sharex=True,
        sharey=True,
        squeeze=False,
        gridspec_kw={"bottom": FOOT_IN / HEIGHT_IN, "top": 1.0 - HEAD_IN / HEIGHT_IN, "left": 0.07, "right": 0.99},
    )
    figure.suptitle(_title(case), fontsize=11)
    for axes, (title, found) in zip(row[0], panels, strict=True):
        arrows = _draw_current(axes, case, low, high)
        _places(axes, case)
        _draw_paths(axes, records, found)
        axes.set(title=title, xlabel="east [m]", aspect="equal")
        axes.set_xlim(low[1], high[1])
        axes.set_ylim(low[0], high[0])
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.09), frameon=False, handlelength=2.6)
    if arrows is not None:
        shown = float(f"{max(np.hypot(arrows.U, arrows.V)):.1g}")
        axes.quiverkey(arrows, 0.93, 1.07, shown, f"current {shown:g} m/s", labelpos="W", fontproperties={"size": 9})
    row[0, 0].set_ylabel("north [m]")
    return figure


def _title(case: Case) -> str:
    """What a case is, for whoever has not read of it."""
    laps = f", {case.laps} laps of which the last is thick" if case.laps > 1 else ""
    place = "the paper's tank" if case.tank else "open water"
    return f"{case.name.upper()}: {place}, {case.flow_name}{laps}; joules a lap, and times the optimum's"


def _extent(case: Case, records: dict[str, Record], flights: Sequence[EnergyFlight]) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest north and east (2,) of what is shown."""
    if case.tank:
        walls = np.array([TANK_X_M, TANK_Y_M])
        return -walls, walls
    everything = np.vstack([records[case.name].track_ned_m, *(flight.track for flight in flights)])
    return everything.min(axis=0) - 1.5, everything.max(axis=0) + 1.5


def _draw_current(axes: Any, case: Case, low: FloatArray, high: FloatArray) -> Any:
    """The current as arrows, where it flows."""
    every = float((high - low).max()) / ARROWS
    north, east = np.meshgrid(*(np.arange(a + every / 2.0, b, every) for a, b in zip(low, high, strict=True)))
    flow = np.stack(np.broadcast_arrays(*case.flow(north, east, np)))
    speed = np.hypot(*flow)
    seen = speed > LEAST_FRACTION * float(speed.max())
    if not seen.any():
        return None
    return axes.quiver(
        east[seen],
        north[seen],
        *(part[seen] for part in flow[::-1]),
        color="0.7",
        angles="xy",
        scale_units="xy",
        scale=float(speed.max()) / (1.3 * every),
        width=0.006,
        zorder=1,
    )


def _places(axes: Any, case: Case) -> None:
    """Obstacles, what the body keeps the centre out of, and the goals with their regions."""
    from matplotlib.patches import Circle

    for x, y, radius in CYLINDERS if case.tank else ():
        axes.add_patch(Circle((y, x), radius, color="0.35", zorder=2))
        axes.add_patch(Circle((y, x), radius + BODY_RADIUS_M, fill=False, ec="0.35", ls=":", lw=1.0, zorder=2))
    places = {"start": case.start[:2], "goal": case.goals[-1].pos_ned_m[:2]}
    if len(case.goals) > 1:
        places = {chr(ord("A") + (i + 1) % len(case.goals)): goal.pos_ned_m[:2] for i, goal in enumerate(case.goals)}
    for name, (x, y) in places.items():
        if name != "start":
            axes.add_patch(Circle((y, x), REGION_M, color="#DCEBD5", zorder=0))
            axes.add_patch(Circle((y, x), REGION_M, fill=False, ec="0.4", lw=0.8, zorder=2))
        axes.plot(y, x, "k^" if name == "start" else "k+", markersize=6, zorder=5)
        axes.annotate(name, (y, x), (5, 4), textcoords="offset points", fontsize=9, fontweight="bold", zorder=6)


def _draw_paths(axes: Any, records: dict[str, Record], flights: Sequence[EnergyFlight]) -> None:
    """The optima that the flights of a panel are compared with, and above them the flights."""
    others = {flight.pilot: comparator(records, flight.case, flight.laps, flight.corridor, None) for flight in flights}
    optima = dict.fromkeys(other.name for other in others.values())
    for name in optima:
        track = records[name].track_ned_m
        caption, style = OPTIMA[name != next(iter(optima))]
        axes.plot(track[:, 1], track[:, 0], ls=style, color="k", lw=2.2, label=caption, zorder=2.5)
    ordered = sorted(flights, key=lambda flight: GROUPS.index(group_of(flight)))
    for flight, (colour, style) in zip(ordered, itertools.cycle(LOOKS)):
        own = comparator(records, flight.case, flight.laps, flight.corridor, flight.drag)
        energy = f"{flight.lap_j:.0f} J, {flight.lap_j / own.lap_j:.2f}" if flight.finished else "not reached"
        last = _last_lap(flight)
        for part, width, label in (
            (flight.track[: last + 1], 0.6, None),
            (flight.track[last:], 1.7, f"{flight.pilot}: {energy}"),
        ):
            axes.plot(part[:, 1], part[:, 0], ls=style, color=colour, lw=width, label=label, zorder=3)
        _heads(axes, flight.track[last:], colour)


def _last_lap(flight: EnergyFlight) -> int:
    """Where the track of a flight begins its last lap; tracks have a point at every step."""
    legs = len(flight.leg_s) // flight.laps
    if not flight.finished or flight.laps == 1:
        return 0
    return int(len(flight.track) * sum(flight.leg_s[:-legs]) / sum(flight.leg_s))


def _heads(axes: Any, path: FloatArray, colour: str) -> None:
    """Arrow heads along a way (n, 2), evenly by its length: the direction of travel."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
    for fraction in (np.arange(HEADS) + 0.5) / HEADS:
        at = int(np.searchsorted(along, fraction * along[-1]))
        before = int(np.searchsorted(along, (fraction - HEAD_FRACTION) * along[-1]))
        if at > before:
            style = {"arrowstyle": "-|>", "color": colour, "linewidth": 0.0, "mutation_scale": 11.0}
            axes.annotate("", path[at, ::-1], path[before, ::-1], arrowprops=style, zorder=4)


def group_of(flight: EnergyFlight) -> Group:
    """What the pilot of a flight knew; the first group that its name speaks of."""
    return next(group for group in GROUPS if any(name in flight.pilot for name in group.names))


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
