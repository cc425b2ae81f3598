"""``autopilot bench``: the benchmarks, each beside what it is measured against."""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import click

from autopilot.cli.output import emit_json, print_table

APART = ("modes", "faults", "sensor-faults", "thruster-health", "vehicles", "detection", "fuzz", "kills", "soak")
"""Only when they are named."""
NAMES = ("nmpc", "sitl", "estimator", "pockets", "energy", "energy-latency", "loop", *APART)
LONG = ("estimator", "pockets", "energy", "energy-latency")
"""Short when all are run."""


@click.command()
@click.argument("name", type=click.Choice(NAMES), required=False)
@click.option("--short", is_flag=True, help="Fewer samples, for a quick look.")
@click.option("--recompute", is_flag=True, help="energy: compute the optima anew first (minutes).")
@click.option("--images", is_flag=True, help="estimator: accuracy of poses from whole pictures instead of flights.")
@click.option("--attitude", is_flag=True, help="estimator: attitude from raw sensors instead of flights.")
@click.option(
    "--seeds",
    metavar="A..B",
    help="estimator: fly these seeds (default 1..20, with pictures 1..3); --attitude: motions with them (101..110).",
)
@click.option("--only", multiple=True, metavar="GROUP", help="estimator: only these rows (steady, haze, laid ...).")
@click.option(
    "--data",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="estimator --attitude: folder of recorded trials (default: those of a checkout's tests).",
)
@click.option(
    "--figures", type=click.Path(file_okay=False), help="energy, estimator --images: write figures into this folder."
)
@click.option("--part", help="faults: only the findings of this part (loop, plans ...).")
@click.option("--markdown", is_flag=True, help="faults: print the table as docs/reliability.md has it.")
@click.option("--messages", type=click.IntRange(1), help="fuzz: how many (default 1000000, with --short 20000).")
@click.option(
    "--runs",
    "sound_runs",
    type=click.IntRange(1),
    help="thruster-health: sound flights (300); vehicles: how many (40); kills: how many (100); with --short 4.",
)
@click.option(
    "--out", type=click.Path(file_okay=False), help="thruster-health: keep flights here, go on where it was stopped."
)
@click.option("--frames", type=click.IntRange(1), help="detection: pictures (default 10000, with --short 400).")
@click.option("--seed", type=int, help="fuzz, detection, vehicles, kills, soak: where these come from (default 1).")
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
def bench(
    name: str | None,
    short: bool,
    recompute: bool,
    images: bool,
    attitude: bool,
    seeds: str | None,
    only: tuple[str, ...],
    data: Path | None,
    figures: str | None,
    part: str | None,
    markdown: bool,
    messages: int | None,
    sound_runs: int | None,
    out: str | None,
    frames: int | None,
    seed: int | None,
    as_json: bool,
) -> None:
    """Run the benchmark NAME, or all.

    nmpc: CPU time of one control step for several grids, beside IPOPT and fatrop on the same problems in the same run;
    with 2, 10 and 50 obstacles; failures from 200 random starts; start-up and memory (minutes; less with --short).
    sitl: speed against real time, CPU time per tick and memory, with a rendered camera and with pose samples.
    estimator: accuracy, honesty, gaps, outliers and delays of the estimator in flights of the whole vehicle, beside
    what the project asks for, over floors whose sheets somebody has laid, with a camera calibrated wrongly, and its
    cost, with the least, median and
    largest of the seeds; 20 seeds take half an hour, 3 (--short, or when no NAME is given) five minutes, --seeds
    201..220 an hour: all with pictures, too. --only GROUP (repeatable) shows some of it: steady, pictures, haze,
    currents, gaps, outliers, late, compass, laid, calibration, cost.
    With --images instead: poses from rendered pictures against height and turbidity (five minutes, half with --short).
    With --attitude instead: attitude from gyros, accelerometers and magnetometer, in recorded trials and made-up
    motions, beside a filter of fixed gain; the parameters of both chosen without the row that they are tried on (ten
    minutes; with --short not chosen, half a minute; exit code 1 if a bar is not kept).
    pockets: goals behind pockets, cylinders on the line and staggered gaps, reached from 60 starts each (five minutes;
    6 starts with --short, or when no NAME is given).
    energy: energy of closed loops beside the offline optimum (known flow; estimated flow and a wrong model) and
    beside rivals; a quarter of an hour, one minute with --short, or when no NAME is given.
    modes: both costs of the controller (MPC_COST 0 and 1) in the paper's tank and in other waters: energy, time,
    clearance, smoothness, CPU time (five minutes, two with --short).
    energy-latency: CPU time of energy plans per kind of request, in the tank, a basin and open water, beside when their
    answers are due in lockstep (a minute or two; half with --short).
    loop: CPU time of the loop's ticks in real time with a camera, heartbeats and upload times, while 500 items and a
    fence of 50 octagons are uploaded in flight (half a minute).
    faults: what clients, wires, disks and sensors can do to the service: what happened once, what is promised, what
    happens now (some minutes; exit code 1 if a promise is not kept).
    fuzz: a million hostile messages and wild samples into the service on the simulated vehicle: messages per second,
    exceptions and broken rules, growth of memory (half an hour, one minute with --short; exit code 1 if any is found).
    detection: markers found and imagined in 10000 rendered pictures and photographs of several dictionaries, beside
    OpenCV's detector (twenty minutes, one with --short; exit code 1 if any id is false).
    sensor-faults: flights with inertial sensors, lenses, mountings and markers that go wrong, alone and in gaps of 1 to
    5 s: error, honesty and contacts (half an hour; a few minutes with --short).
    thruster-health: sound flights of R1 to R4 in both cost modes and half as many with a lossy thruster, as many of
    random vehicles in random waters: false alarms with their bound, time to find (300 take hours, --out goes on where
    it was stopped; exit code 1 if a sound thruster is blamed).

    vehicles: vehicles with 3 to 8 thrusters anywhere: each flies 20 s in open water or is refused with the axis that
    lacks thrust (an hour; exit code 1 if one does neither).

    kills: SIGKILL at random moments of uploads, changes of parameters and logging: nothing that was accepted may be
    lost, every log is readable (ten minutes; exit code 1 otherwise).

    soak: an hour of simulated laps (--short: ten minutes) in this process: growth of memory after the warm-up and of
    open descriptors (a quarter of an hour; exit code 1 if memory grows by more than 1 % an hour).

    Times depend on the machine and on what else it does: each table says how slow the machine is just now.
    """
    if recompute and name != "energy":
        raise click.UsageError("--recompute belongs to the benchmark energy")
    if images and name != "estimator":
        raise click.UsageError("--images belongs to the benchmark estimator")
    if attitude and (name != "estimator" or images):
        raise click.UsageError("--attitude belongs to the benchmark estimator, without --images")
    chosen_seeds = None if seeds is None else _seed_range(seeds)
    if seeds is not None and (name != "estimator" or images):
        raise click.UsageError("--seeds belongs to the benchmark estimator, without --images")
    if only and (name != "estimator" or images or attitude):
        raise click.UsageError("--only belongs to the benchmark estimator, without --images and --attitude")
    if data is not None and not attitude:
        raise click.UsageError("--data belongs to the benchmark estimator --attitude")
    if figures is not None and name != "energy" and not images:
        raise click.UsageError("--figures belongs to the benchmarks energy and estimator --images")
    if (part is not None or markdown) and name != "faults":
        raise click.UsageError("--part and --markdown belong to the benchmark faults")
    if messages is not None and name != "fuzz":
        raise click.UsageError("--messages belongs to the benchmark fuzz")
    if seed is not None and name not in ("fuzz", "detection", "vehicles", "kills", "soak"):
        raise click.UsageError("--seed belongs to the benchmarks fuzz, detection, vehicles, kills and soak")
    if frames is not None and name != "detection":
        raise click.UsageError("--frames belongs to the benchmark detection")
    if sound_runs is not None and name not in ("thruster-health", "vehicles", "kills"):
        raise click.UsageError("--runs belongs to the benchmarks thruster-health, vehicles and kills")
    if out is not None and name != "thruster-health":
        raise click.UsageError("--out belongs to the benchmark thruster-health")
    if recompute:
        _recompute()
    if attitude:
        _attitude(short, data, chosen_seeds, as_json=as_json)
        return
    if name == "fuzz":
        _fuzz(messages or (20_000 if short else 1_000_000), 1 if seed is None else seed, as_json=as_json)
        return
    if name == "detection":
        _detection(frames or (400 if short else 10_000), 1 if seed is None else seed, as_json=as_json)
        return
    if name == "faults":
        _faults(part, as_json=as_json, as_markdown=markdown)
        return
    if name == "thruster-health":
        _thruster_health(sound_runs or (4 if short else 300), out, as_json=as_json)
        return
    if name == "vehicles":
        _vehicles(sound_runs or (4 if short else 40), 1 if seed is None else seed, as_json=as_json)
        return
    if name == "kills":
        _kills(sound_runs or (4 if short else 100), 1 if seed is None else seed, as_json=as_json)
        return
    if name == "soak":
        _soak(600.0 if short else 3600.0, 1 if seed is None else seed, as_json=as_json)
        return
    if name == "sensor-faults":
        _sensor_faults(short, as_json=as_json)
        return
    chosen = [each for each in NAMES if each not in APART] if name is None else [name]
    results: dict[str, object] = {}
    for each in chosen:
        slow = _slowness()
        brief = short or (each in LONG and name is None)
        title = "images" if images else each
        runs: dict[str, Callable[[bool], list[dict[str, object]]]] = {
            "nmpc": _nmpc,
            "sitl": _sitl,
            "estimator": partial(_estimator, seeds=chosen_seeds, groups=only),
            "pockets": _pockets,
            "energy-latency": _latency,
            "loop": _loop,
            "modes": _modes,
        }
        if each == "energy":
            rows = _energy(brief, figures)
        else:
            rows = _images(brief, figures) if images else runs[each](brief)
        slow = 0.5 * (slow + _slowness())
        results[each] = {"machine_slowness": slow, "rows": rows}
        if not as_json:
            _print(title, rows)
            click.echo(f"the machine was {slow:.1f} times slower during this than when the asked figures were set")
    if as_json:
        emit_json(results)


def _seed_range(text: str) -> range:
    """``A..B``, both included."""
    first, dots, last = text.partition("..")
    if not (dots and first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
        raise click.UsageError(f"--seeds {text}: give the first and the last seed, as in 201..220")
    return range(int(first), int(last) + 1)


def _attitude(short: bool, data: Path | None, seeds: range | None, *, as_json: bool) -> None:
    """Print the table and the median; exit code 1 if a bar is not kept."""
    from autopilot.bench.attitude import INCLINATION_BAR_DEG, bench_attitude, median_inclination
    from autopilot.bench.attitude_recordings import FOLDER, load_trials

    folder = FOLDER if data is None else data
    if not load_trials(folder):
        click.echo(f"no recorded trials in {folder}: made-up motions only; give --data FOLDER", err=True)
    rows = bench_attitude(short, folder, seeds)
    median = median_inclination(rows)
    if as_json:
        emit_json({"rows": [asdict(row) for row in rows], "median_inclination": median})
    else:
        _print("attitude", [asdict(row) for row in rows])
        click.echo(f"median inclination {median:.2f} deg, asked <= {INCLINATION_BAR_DEG:g}")
    if median > INCLINATION_BAR_DEG or any(row.missed for row in rows):
        raise SystemExit(1)


def _faults(part: str | None, *, as_json: bool, as_markdown: bool) -> None:
    """Print the table of faults; exit code 1 if a promise is not kept."""
    from autopilot.bench.faults.bench import PARTS, bench_faults, markdown

    if part is not None and part not in PARTS:
        raise click.UsageError(f"--part {part}: there is {', '.join(PARTS)}")
    rows = bench_faults(part, lambda line: click.echo(line, err=True))
    if as_json:
        emit_json([asdict(row) for row in rows])
    elif as_markdown:
        click.echo(markdown(rows), nl=False)
    else:
        columns = ("part", "finding", "before", "promise", "now", "kept")
        print_table(TITLES["faults"], list(columns), [[str(getattr(row, c)) for c in columns] for row in rows])
    if not all(row.kept for row in rows):
        raise SystemExit(1)


def _fuzz(messages: int, seed: int, *, as_json: bool) -> None:
    """Run the fuzzer; exit code 1 if it finds anything."""
    from autopilot.bench.fuzz.run import Result, run_fuzz

    shown = 0

    def show(result: Result) -> None:
        nonlocal shown
        click.echo(f"{result.messages} messages, {result.per_second:.0f}/s, {len(result.failures)} failures", err=True)
        for line in result.failures[shown:]:
            click.echo(line, err=True)
        shown = len(result.failures)

    result = run_fuzz(messages, seed, show)
    if as_json:
        emit_json({**asdict(result), "per_second": result.per_second})
    else:
        print_table(TITLES["fuzz"], ["figure", "value"], [[name, value] for name, value in result.rows()])
    if result.failures:
        raise SystemExit(1)


def _sensor_faults(short: bool, *, as_json: bool) -> None:
    """Print the campaign; exit code 1 if a promise is not kept."""
    from autopilot.bench.fault_campaign import HIDDEN, bench_sensor_faults

    rows = list(bench_sensor_faults(short, lambda line: click.echo(line, err=True)))
    if as_json:
        emit_json([asdict(row) for row in rows])
    else:
        _print("sensor-faults", [asdict(row) for row in rows])
    if not all(row.kept for row in rows if row.fault not in HIDDEN):
        raise SystemExit(1)


def _detection(frames: int, seed: int, *, as_json: bool) -> None:
    """Print what is found and imagined; exit code 1 if an id is false."""
    from autopilot.bench.detection import bench_detection, totals

    rows = []
    for row in bench_detection(frames, seed):
        click.echo(f"{row.source}: {row.false_ids + row.blind_false_ids} false ids", err=True)
        rows.append(row)
    rows.append(totals(rows))
    if as_json:
        emit_json([asdict(row) for row in rows])
    else:
        _print("detection", [asdict(row) for row in rows])
    if rows[-1].false_ids or rows[-1].blind_false_ids:
        raise SystemExit(1)


def _vehicles(runs: int, first: int, *, as_json: bool) -> None:
    """Make and fly vehicles; exit code 1 if one neither flies nor is refused for an axis."""
    from autopilot.bench.any_vehicle import fly

    outcomes = []
    for seed in range(first, first + runs):
        outcomes.append(fly(seed))
        click.echo(f"vehicle {seed}: {outcomes[-1].problem or outcomes[-1].refused or 'flown'}", err=True)
    rows = [{**asdict(each), "problem": each.problem} for each in outcomes]
    if as_json:
        emit_json(rows)
    else:
        _print("vehicles", rows)
    if any(each.problem for each in outcomes):
        raise SystemExit(1)


def _kills(runs: int, seed: int, *, as_json: bool) -> None:
    """Kill and look; exit code 1 if something accepted is lost or a log is damaged."""
    from autopilot.bench.kills import run

    found = run(runs, seed, lambda kills: click.echo(f"kill {kills} of {runs}", err=True))
    row = asdict(found)
    if as_json:
        emit_json(row)
    else:
        starts = sorted(row.pop("start_cpu_s"))
        shown = {"start_cpu_s": f"{starts[len(starts) // 2]:.1f} ({starts[-1]:.1f} at most)"}
        _print("kills", [{**row, **{key: len(row[key]) for key in ("lost", "damaged_logs")}, **shown}])
        for line in (*found.lost, *found.damaged_logs):
            click.echo(line)
    if found.lost or found.damaged_logs:
        raise SystemExit(1)


def _soak(duration_s: float, seed: int, *, as_json: bool) -> None:
    """Fly and look; exit code 1 if something grows."""
    from autopilot.bench.soak import soak

    flight = soak(duration_s, seed, lambda look: click.echo(f"{look.t_s:6.0f} s  {look.rss_mb:7.1f} MB", err=True))
    last = flight.looks[-1]
    row: dict[str, object] = {
        "flown_s": last.t_s,
        "settled_mb": flight.settled[0].rss_mb,
        "end_mb": last.rss_mb,
        "growth_mb": flight.growth_mb,
        "hourly_growth": flight.hourly_growth,
        "more_descriptors": flight.more_descriptors,
        "threads": last.threads,
    }
    if as_json:
        emit_json({**row, "looks": [asdict(look) for look in flight.looks]})
    else:
        _print("soak", [row])
    if not flight.kept:
        raise SystemExit(1)


def _thruster_health(runs: int, out: str | None, *, as_json: bool) -> None:
    """Fly and print; exit code 1 if a sound thruster is blamed."""
    from autopilot.bench.thruster_health import bench_thruster_health

    folder = None if out is None else Path(out)
    rows = list(bench_thruster_health(runs, (runs + 1) // 2, folder, lambda line: click.echo(line, err=True)))
    if as_json:
        emit_json([asdict(row) for row in rows])
    else:
        _print("thruster-health", [asdict(row) for row in rows])
    if any(row.false for row in rows):
        raise SystemExit(1)


def _slowness() -> float:
    from autopilot.bench.machine import slowness

    return slowness()


def _nmpc(short: bool) -> list[dict[str, object]]:
    from autopilot.bench.nmpc import STARTS, bench_nmpc

    rows = bench_nmpc(steps=100 if short else 400, slowness=_slowness(), starts=STARTS // 10 if short else STARTS)
    return [asdict(row) for row in rows]


def _sitl(short: bool) -> list[dict[str, object]]:
    from autopilot.bench.sitl import bench_sitl

    return [asdict(row) for row in bench_sitl(duration_s=10.0 if short else 30.0)]


def _estimator(short: bool, seeds: range | None = None, groups: tuple[str, ...] = ()) -> list[dict[str, object]]:
    from autopilot.bench.estimator import (
        CAMERA_SEEDS,
        COST,
        SEEDS,
        SHORT_CAMERA_SEEDS,
        SHORT_SEEDS,
        bench_estimator,
        group_names,
    )
    from autopilot.bench.estimator_cost import COST_S, SHORT_COST_S, bench_cost

    for name in groups:
        if name not in group_names():
            raise click.UsageError(f"--only {name}: there is {', '.join(group_names())}")
    poses, pictures = (SHORT_SEEDS, SHORT_CAMERA_SEEDS) if short else (SEEDS, CAMERA_SEEDS)
    rows = bench_estimator(seeds or poses, seeds or pictures, groups=groups or None)
    if not groups or COST in groups:
        rows += bench_cost(SHORT_COST_S if short else COST_S)
    return [asdict(row) for row in rows]


def _loop(short: bool) -> list[dict[str, object]]:
    from autopilot.bench.loop import bench_loop

    return [{**asdict(row), "kept": row.kept} for row in bench_loop()]


def _images(short: bool, figures: str | None) -> list[dict[str, object]]:
    from autopilot.bench.estimator_images import bench_images

    rows = list(bench_images(short))
    if figures is not None:
        from autopilot.bench.estimator_plots import draw_images

        click.echo(draw_images(rows, figures), err=True)
    return [asdict(row) for row in rows]


def _pockets(short: bool) -> list[dict[str, object]]:
    from autopilot.bench.pockets import SHORT_STARTS, STARTS, bench_pockets

    return [asdict(row) for row in bench_pockets(SHORT_STARTS if short else STARTS)]


def _modes(short: bool) -> list[dict[str, object]]:
    from autopilot.bench.modes import bench_modes

    return [asdict(row) for row in bench_modes(short, lambda line: click.echo(line, err=True))]


def _latency(short: bool) -> list[dict[str, object]]:
    from autopilot.bench.energy.latency import RUNS, SHORT_RUNS, bench_latency

    return [asdict(row) for row in bench_latency(SHORT_RUNS if short else RUNS, slowness=_slowness())]


def _recompute() -> None:
    from autopilot.bench.energy.record import recompute, save_records

    save_records(recompute(lambda line: click.echo(line, err=True)))


def _energy(short: bool, figures: str | None) -> list[dict[str, object]]:
    from autopilot.bench.energy.bench import bench_energy

    result = bench_energy(short, lambda line: click.echo(line, err=True))
    if figures is not None:
        from autopilot.bench.energy.figures import draw

        for path in draw(result.flights, figures):
            click.echo(path, err=True)
    return [asdict(row) for row in result.rows]


TITLES = {
    "loop": "The loop in real time with a camera, 500 items and 50 octagons uploaded in flight; asked = at most",
    "fuzz": "Hostile messages and samples into the service on the simulated vehicle, in lockstep",
    "faults": "What comes from outside, and what the service makes of it; before = at revision 0501193",
    "sensor-faults": "Worst of the seeds from the beginning of the fault on; kept: inside 3 sigma in 95 % of the ticks,"
    " called good for at most 1 s when far off, no contact, nothing blamed on thrusters",
    "thruster-health": "Sound and lossy thrusters; false = flights with a word about a sound one, false_below with 95 %"
    " confidence; times from the loss on, inf = not within 35 s",
    "kills": "A service killed at random moments: changes accepted, killed in the middle of one, lost, and its logs",
    "soak": "Laps without end: memory after the warm-up, its growth per hour, descriptors",
    "vehicles": "Vehicles made at random, 20 s in open water each: flown or refused with the axis that lacks thrust",
    "detection": "Markers shown and found with a prediction, by OpenCV's defaults, by these and not by us, false ids;"
    " the same without a prediction; median CPU time [ms] of ours, of OpenCV's, of ours at the reference speed",
    "nmpc": "One control step, CPU time; normal_ms = the median at the reference speed, bar and goal are for that",
    "sitl": "The paper's mission with its log; speed = simulated over wall time, asked = what the project asks for",
    "estimator": "Estimate against truth in the paper's tank, rms unless said otherwise; measured = over all"
    " seeds; low, median, high = of the single ones",
    "images": "Poses from rendered pictures, rms of the fixes; asked: 0.45 to 1.2 m: 2 mm and 0.05 deg up to 1 1/m,"
    " 5 mm at 2; none lost up to turbidity x height 2; laser 10 mm at 0.8 m; normal_ms <= 8 up to 0.8 m; missed = not"
    " kept",
    "attitude": "Attitude from raw sensors, deg rms; asked: at most 10 % above the filter with fixed gains;"
    " missed = not kept; chosen = tilt s, heading s, noise deg/s | gains of tilt, heading, bias",
    "energy-latency": "Energy plans: CPU seconds per kind of request, and when answers are due in lockstep",
    "energy": "Energy per lap beside the optimum with the same freedom (laps, corridor, vehicle flown), or a rival's;"
    " flow known: MPC_MARGIN 0.02, MPC_SPEED_MARGIN 0.01, MPC_W_* 0",
    "modes": "Both costs in the service on the simulated vehicle, the water unknown; nearest = beyond what is to be"
    " kept; cpu_ms = of the whole process per control step",
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
    "normal_ms": "norm. ms",
    "simulated_s": "sim. s",
    "cpu_s_per_s": "cpu s/s",
    "beside_s_per_s": "beside",
    "tick_mean_ms": "tick ms",
    "predict_us": "pred. us",
    "tick_per_predict": "ratio",
    "tick_median_ms": "median",
    "tick_p99_ms": "p99",
    "step_median_ms": "step ms",
    "step_p99_ms": "p99",
    "step_max_ms": "max",
}
"""Heads of columns that are long."""


def _print(name: str, rows: list[dict[str, object]]) -> None:
    columns = [column for column in rows[0] if column != "parts"]
    heads = [HEADS.get(column, column) if name in ("images", "attitude", "sitl") else column for column in columns]
    print_table(TITLES[name], heads, [[_figure(row[column]) for column in columns] for row in rows])
    for row in rows:
        if "parts" in row:
            click.echo(f"{row[columns[0]]}, mean tick by part [ms]: {row['parts']}")


def _figure(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)
