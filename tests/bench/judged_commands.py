"""Benchmarks that end with exit code 1 when a promise is not kept."""

from dataclasses import asdict
from pathlib import Path

import click

from autopilot.cli.bench_rows import SHORT, print_rows
from autopilot.cli.click_types import FiniteRange
from autopilot.cli.console_output import print_table
from autopilot.cli.shared_options import JSON
from tests.bench.tables import TITLES, judge, judge_rows, seed_range, tell

PICTURE_KINDS = ("near_frozen", "repeated", "delayed", "mirrored", "half_frozen", "elsewhere", "reflection")
_SEED = click.option("--seed", type=int, default=1, show_default=True, help="Where its random numbers come from.")


@click.command()
@SHORT
@click.option("--messages", type=click.IntRange(1), help="How many (default 1000000, with --short 20000).")
@_SEED
@JSON
def fuzz(short: bool, messages: int | None, seed: int, as_json: bool) -> None:
    """A million hostile messages and wild samples into the service.

    On the simulated vehicle: messages per second, exceptions and broken rules, growth of memory (half an hour, one
    minute with --short; exit code 1 if any is found).
    """
    from tests.bench.fuzz.result import Result
    from tests.bench.fuzz.run import run_fuzz

    shown = 0

    def show(result: Result) -> None:
        nonlocal shown
        so_far = f"{result.messages} messages, {result.per_second:.0f}/s, {result.rss_end_mb:.0f} MB"
        tell(f"{so_far}, {len(result.failures)} failures")
        for line in result.failures[shown:]:
            tell(line)
        shown = len(result.failures)

    result = run_fuzz(messages or (20_000 if short else 1_000_000), seed, show)
    judge(
        not result.failures,
        result.figures(),
        lambda: print_table(TITLES["fuzz"], ["figure", "value"], result.rows()),
        as_json=as_json,
    )


@click.command("sensor-faults")
@SHORT
@JSON
def sensor_faults(short: bool, as_json: bool) -> None:
    """Flights with sensors, lenses, mountings and markers that go wrong.

    Alone and in gaps of 1 to 5 s: error, honesty and contacts (half an hour; a few minutes with --short).
    """
    from tests.bench.fault_campaign import HIDDEN, bench_sensor_faults

    rows = list(bench_sensor_faults(short, tell))
    kept = all(row.kept for row in rows if row.fault not in HIDDEN)
    judge_rows(kept, "sensor-faults", [asdict(row) for row in rows], as_json=as_json)


@click.command("picture-faults")
@SHORT
@click.option("--kind", "kinds", multiple=True, type=click.Choice(PICTURE_KINDS), help="Only these kinds of faults.")
@click.option("--sensors", type=click.Choice(("pose", "camera")), default="camera", show_default=True)
@click.option(
    "--seeds",
    metavar="A..B",
    callback=seed_range,
    help="First and last seed (default 1..20, with --short 1..2).",
)
@JSON
def picture_faults(short: bool, kinds: tuple[str, ...], sensors: str, seeds: range | None, as_json: bool) -> None:
    """Flights with pictures that look right and are not of here and now.

    Near-frozen, repeated, delayed, mirrored, half-frozen, of another place, with reflections, 1 to 10 s each (an hour
    with rendered pictures, ten minutes with the pose sensor; exit code 1 if a promise is not kept).
    """
    from tests.bench.picture_faults import SEEDS, SHORT_SEEDS, bench_picture_faults

    chosen = seeds or (SHORT_SEEDS if short else SEEDS)
    rows = list(bench_picture_faults(kinds or PICTURE_KINDS, chosen, sensors, tell))
    shown = [{key: value for key, value in asdict(row).items() if as_json or key != "texts"} for row in rows]
    judge_rows(all(row.kept for row in rows), "picture-faults", shown, as_json=as_json)


@click.command()
@SHORT
@click.option("--frames", type=click.IntRange(1), help="Pictures (default 10000, with --short 400).")
@_SEED
@JSON
def detection(short: bool, frames: int | None, seed: int, as_json: bool) -> None:
    """Markers found and imagined in 10000 pictures, beside OpenCV.

    Rendered pictures and photographs of several dictionaries (twenty minutes, one with --short; exit code 1 if any id
    is false).
    """
    from tests.bench.detection import bench_detection, totals

    rows = []
    for row in bench_detection(frames or (400 if short else 10_000), seed):
        tell(f"{row.source}: {row.false_ids + row.blind_false_ids} false ids")
        rows.append(row)
    rows.append(totals(rows))
    kept = not (rows[-1].false_ids or rows[-1].blind_false_ids)
    judge_rows(kept, "detection", [asdict(row) for row in rows], as_json=as_json)


@click.command()
@SHORT
@click.option("--runs", type=click.IntRange(1), help="How many (default 40, with --short 4).")
@_SEED
@JSON
def vehicles(short: bool, runs: int | None, seed: int, as_json: bool) -> None:
    """Vehicles with 3 to 8 thrusters anywhere: flown or refused.

    Each flies 20 s in open water or is refused with the axis that lacks thrust (an hour; exit code 1 if one does
    neither).
    """
    from tests.bench.any_vehicle import fly

    outcomes = []
    for number in range(seed, seed + (runs or (4 if short else 40))):
        outcomes.append(fly(number))
        tell(f"vehicle {number}: {outcomes[-1].problem or outcomes[-1].refused or 'flown'}")
    kept = not any(each.problem for each in outcomes)
    judge_rows(kept, "vehicles", [{**asdict(each), "problem": each.problem} for each in outcomes], as_json=as_json)


@click.command()
@SHORT
@click.option("--runs", type=click.IntRange(1), help="How many (default 100, with --short 4).")
@_SEED
@JSON
def kills(short: bool, runs: int | None, seed: int, as_json: bool) -> None:
    """SIGKILL at random moments: nothing accepted may be lost.

    In uploads, changes of parameters and logging; every log has to be readable (ten minutes; exit code 1 otherwise).
    """
    from tests.bench.kills import run

    count = runs or (4 if short else 100)
    found = run(count, seed, lambda done: tell(f"kill {done} of {count}"))
    row = asdict(found)

    def show() -> None:
        starts = sorted(found.start_cpu_s)
        counts = {key: len(row[key]) for key in ("lost", "damaged_logs")}
        spread = f"{starts[len(starts) // 2]:.1f} ({starts[-1]:.1f} at most)"
        print_rows(TITLES["kills"], [{**row, **counts, "start_cpu_s": spread}])
        for line in (*found.lost, *found.damaged_logs):
            click.echo(line)

    judge(not (found.lost or found.damaged_logs), row, show, as_json=as_json)


@click.command()
@SHORT
@_SEED
@JSON
def soak(short: bool, seed: int, as_json: bool) -> None:
    """An hour of simulated laps and what it leaves in memory.

    In this process (--short: ten minutes of laps): growth of memory after the warm-up and of open descriptors (a
    quarter of an hour; exit code 1 if memory grows by more than 1 % an hour).
    """
    from tests.bench.soak import soak as run

    flight = run(600.0 if short else 3600.0, seed, lambda look: tell(f"{look.t_s:6.0f} s  {look.rss_mb:7.1f} MB"))
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
    looks = [asdict(look) for look in flight.looks]
    judge(flight.kept, {**row, "looks": looks}, lambda: print_rows(TITLES["soak"], [row]), as_json=as_json)


@click.command()
@SHORT
@click.option("--runs", type=click.IntRange(1), help="Seeds (default 20, with --short 1).")
@click.option("--duration", type=FiniteRange(6.0), help="Of each flight [s] (default 600, with --short 30).")
@click.option("--sensors", type=click.Choice(("pose", "camera")), default="pose", show_default=True)
@click.option("--only", metavar="SCENARIO", help="This one alone.")
@_SEED
@JSON
def alarms(
    short: bool, runs: int | None, duration: float | None, sensors: str, only: str | None, seed: int, as_json: bool
) -> None:
    """Sound vehicles that raise an alarm: no warning is allowed.

    All scenarios and vehicles without a fault, a third of the time each disarmed, armed and on the mission (hours, ten
    minutes with --short; exit code 1 if any WARNING or worse is said).
    """
    from tests.bench.alarms import FLIGHTS, bench_alarms

    if only is not None and only not in {scenario for scenario, _ in FLIGHTS}:
        raise click.UsageError(f"--only {only}: there is {', '.join(dict(FLIGHTS))}")
    flights = []
    for flight in bench_alarms(
        range(seed, seed + (runs or (1 if short else 20))), duration or (30.0 if short else 600.0), sensors, only
    ):
        tell(f"{flight.scenario} {flight.vehicle} seed {flight.seed}: {', '.join(flight.alarms) or 'quiet'}")
        flights.append(flight)
    judge_rows(all(each.kept for each in flights), "alarms", [asdict(each) for each in flights], as_json=as_json)


@click.command("thruster-health")
@SHORT
@click.option("--runs", type=click.IntRange(1), help="Sound flights (default 300, with --short 4).")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Keep flights here, go on where stopped.")
@JSON
def thruster_health(short: bool, runs: int | None, out: Path | None, as_json: bool) -> None:
    """Sound and lossy thrusters: false alarms, time to find.

    Sound flights of R1 to R4 in both cost modes and half as many with a lossy thruster, as many of random vehicles in
    random waters (300 take hours, --out goes on where it was stopped; exit code 1 if a sound thruster is blamed).
    """
    from tests.bench.thruster_health import bench_thruster_health

    count = runs or (4 if short else 300)
    rows = list(bench_thruster_health(count, (count + 1) // 2, out, tell))
    judge_rows(not any(row.false for row in rows), "thruster-health", [asdict(row) for row in rows], as_json=as_json)
