"""How studies print: titles, short heads, how far they are, and the exit code of those that promise something."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import click

from autopilot.cli.bench_rows import Rows, print_rows
from autopilot.cli.console_output import emit_json, progress_bar

_Part = TypeVar("_Part")
_Result = TypeVar("_Result")

TITLES = {
    "fuzz": "Hostile messages and samples into the service on the simulated vehicle, in lockstep",
    "sensor-faults": "Worst of the seeds from the beginning of the fault on; kept: inside 3 sigma in 95 % of the ticks,"
    " called good for at most 1 s when far off, no contact, nothing blamed on thrusters",
    "picture-faults": "Pictures that are not of here and now; kept: no contact, outside 3 sigma called good for at most"
    " 0.5 s; back = from the fault's end to the first fix used; blamed = a sound thruster or inertial sensor",
    "thruster-health": "Sound and lossy thrusters; false = flights with a word about a sound one, false_below with 95 %"
    " confidence; times from the loss on, inf = not within 35 s",
    "replay": "Flights and their replays: fields that differ, and the first of them",
    "reference": "Figures of the reference flights that have moved since they were kept",
    "kills": "A service killed at random moments: changes accepted, killed in the middle of one, lost, and its logs",
    "alarms": "Sound vehicles, disarmed, holding and flying: what was said that was not true",
    "soak": "Laps without end: memory after the warm-up, its growth per hour, descriptors",
    "vehicles": "Vehicles made at random, 20 s in open water each: flown or refused with the axis that lacks thrust",
    "detection": "Markers shown and found with a prediction, by OpenCV's defaults, by these and not by us, false ids;"
    " the same without a prediction; median CPU time [ms] of ours and of OpenCV's",
    "estimator": "Estimate against truth in the paper's tank, rms unless said otherwise; measured = over all"
    " seeds; low, median, high = of the single ones",
    "images": "Poses from rendered pictures, rms of the fixes; asked: 0.45 to 1.2 m: 2 mm and 0.05 deg up to 1 1/m,"
    " 5 mm at 2; none lost up to turbidity x height 2; laser 10 mm at 0.8 m; cpu_ms <= 8 up to 0.8 m; missed = not"
    " kept",
    "attitude": "Attitude from raw sensors, deg rms; asked: at most 10 % above the filter with fixed gains;"
    " missed = not kept; chosen = tilt s, heading s, noise deg/s | gains of tilt, heading, bias",
    "energy-latency": "Energy plans: CPU seconds per kind of request, and when answers are due in lockstep",
    "energy-legs": "Energy plans of random legs, seconds of CPU and by the clock; slow = more than 1 s of CPU",
    "energy-rivals": "Legs at shipped defaults in the service on the simulated vehicle: J of its thrusters beside the"
    " optimum with the same drag and thrust; s = until the acceptance ball is entered",
    "energy": "Energy per lap beside the optimum with the same freedom (laps, corridor, vehicle flown);"
    " flow known: MPC_MARGIN 0.02, MPC_SPEED_MARGIN 0.01, MPC_W_* 0",
    "turns": "CPU time of two revisions in turns: medians, and the ratios of this one to the other",
    "pockets": "Local minima: goals reached in closed loop; nearest_m = clearance beyond the body radius",
}

HEADS = {
    "turbidity_1_m": "1/m",
    "height_m": "h m",
    "markers": "n",
    "xy_mm": "xy mm",
    "z_mm": "z mm",
    "yaw_deg": "yaw",
    "lost_pct": "lost %",
    "empty_pct": "none %",
    "false_ids": "bad ids",
    "false_fixes": "bad fix",
    "laser_mm": "las. mm",
    "laser_pct": "las. %",
    "laser_bad_pct": "las. bad",
    "found_pct": "start %",
    "inclination": "incl.",
    "fixed_inclination": "fixed incl.",
    "fixed_heading": "head.",
    "fixed_total": "total",
    "vqf_inclination": "VQF incl.",
    "vqf_heading": "head.",
    "vqf_total": "total",
    "cpu_ms": "cpu ms",
    "search_ms": "start ms",
    "cpu_s_per_s": "cpu s/s",
}
"""Heads of the columns of ``images`` and ``attitude``, whose names are long."""


def judge(kept: bool, rows: object, show: Callable[[], None], *, as_json: bool) -> None:
    """The end of a benchmark that promises something: its ``rows`` as JSON, or what ``show`` prints; exit code 1 unless
    the promise was ``kept``."""
    if as_json:
        emit_json(rows)
    else:
        show()
    if not kept:
        raise SystemExit(1)


def judge_rows(kept: bool, title: str, rows: Rows, *, as_json: bool) -> None:
    """As :func:`judge`, of a benchmark whose table has all that there is to show."""
    judge(kept, rows, lambda: print_rows(TITLES[title], rows), as_json=as_json)


def tell(line: str) -> None:
    """How far a long benchmark is: on stderr, so that its table can be kept."""
    click.echo(line, err=True)


def printed_one_by_one(
    parts: Sequence[_Part], work: Callable[[_Part], _Result], outcome: Callable[[_Result], str]
) -> list[_Result]:
    """What ``work`` makes of the parts of a long benchmark, each told on stderr as soon as it is done.

    A terminal shows a bar below these lines, with the part that is worked on.
    """
    results = []
    with progress_bar("{task.description}", elapsed=True, transient=True) as bar:
        task = None if bar is None else bar.add_task("", total=len(parts))
        for number, part in enumerate(parts, 1):
            if bar is not None and task is not None:
                bar.update(task, description=str(part), completed=number - 1)
            results.append(work(part))
            line = f"{number} of {len(parts)}  {part}: {outcome(results[-1])}"
            if bar is None:
                tell(line)
            else:
                bar.console.print(line, highlight=False, markup=False)
    return results


def seed_range(_: click.Context, __: click.Parameter, text: str | None) -> range | None:
    """``A..B``, both included."""
    if text is None:
        return None
    first, dots, last = text.partition("..")
    if not (dots and first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
        raise click.UsageError(f"--seeds {text}: give the first and the last seed, as in 201..220")
    return range(int(first), int(last) + 1)
