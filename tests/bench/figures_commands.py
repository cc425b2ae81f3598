"""Studies that are tables of figures, beside their baselines."""

from dataclasses import asdict
from functools import partial
from pathlib import Path

import click

from autopilot.cli.bench_rows import SHORT, Rows, print_rows, run_one
from autopilot.cli.shared_options import JSON
from tests.bench.tables import HEADS, TITLES, judge, seed_range, tell


@click.command()
@SHORT
@click.option("--images", is_flag=True, help="Accuracy of poses from whole pictures instead of flights.")
@click.option("--attitude", is_flag=True, help="Attitude from raw sensors instead of flights.")
@click.option(
    "--seeds",
    metavar="A..B",
    callback=seed_range,
    help="Fly these seeds (default 1..20, with pictures 1..3); --attitude: motions with them (101..110).",
)
@click.option("--only", multiple=True, metavar="GROUP", help="Only these rows (steady, haze, laid ...); repeatable.")
@click.option(
    "--data",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="--attitude: folder of recorded trials (default: those of a checkout's tests).",
)
@click.option("--figures", type=click.Path(file_okay=False), help="--images, calibration: figures here.")
@JSON
def estimator(
    short: bool,
    images: bool,
    attitude: bool,
    seeds: range | None,
    only: tuple[str, ...],
    data: Path | None,
    figures: str | None,
    as_json: bool,
) -> None:
    """Accuracy and honesty of the estimator, gaps, outliers, delays.

    In flights of the whole vehicle, beside what the project asks for, over floors whose sheets somebody has laid, with
    a camera calibrated wrongly, and its cost, with the least, median and largest of the seeds; 20 seeds take half an
    hour, 3 (--short, or among all benchmarks) five minutes, --seeds 201..220 an hour: all with pictures, too. --only
    GROUP shows some of it: steady, pictures, haze, currents, gaps, outliers, late, compass, laid, calibration, cost.

    With --images instead: poses from rendered pictures against height and turbidity (five minutes, half with --short).

    With --attitude instead: attitude from gyros, accelerometers and magnetometer, in recorded trials and made-up
    motions, beside a filter of fixed gain; the parameters of both chosen without the row that they are tried on (ten
    minutes; with --short not chosen, half a minute; exit code 1 if a bar is not kept).
    """
    for given, option, wanted in (
        (attitude, "--attitude", not images),
        (seeds is not None, "--seeds", not images),
        (bool(only), "--only", not images and not attitude),
        (data is not None, "--data", attitude),
        (figures is not None, "--figures", images or "calibration" in only),
    ):
        if given and not wanted:
            raise click.UsageError(f"{option} belongs to {_WITH[option]}")
    if attitude:
        _attitude(short, data, seeds, as_json=as_json)
    elif images:
        run_one(
            *("estimator", TITLES["images"], partial(_images, figures=figures)),
            short=short,
            as_json=as_json,
            heads=HEADS,
        )
    else:
        run_one(
            "estimator",
            TITLES["estimator"],
            partial(estimator_rows, seeds=seeds, groups=only, figures=figures),
            short=short,
            as_json=as_json,
        )


_WITH = {
    "--attitude": "the benchmark estimator without --images",
    "--seeds": "the benchmark estimator without --images",
    "--only": "the benchmark estimator without --images and --attitude",
    "--data": "the benchmark estimator with --attitude",
    "--figures": "the benchmarks energy, estimator --images and estimator --only calibration",
}
"""Where an option of the benchmark has a meaning."""


def estimator_rows(
    short: bool, seeds: range | None = None, groups: tuple[str, ...] = (), figures: str | None = None
) -> Rows:
    from tests.bench.estimator import (
        CAMERA_SEEDS,
        COST,
        SEEDS,
        SHORT_CAMERA_SEEDS,
        SHORT_SEEDS,
        bench_estimator,
        group_names,
    )
    from tests.bench.estimator_cost import COST_S, SHORT_COST_S, bench_cost

    for name in groups:
        if name not in group_names():
            raise click.UsageError(f"--only {name}: there is {', '.join(group_names())}")
    poses, pictures = (SHORT_SEEDS, SHORT_CAMERA_SEEDS) if short else (SEEDS, CAMERA_SEEDS)
    rows = bench_estimator(seeds or poses, seeds or pictures, groups=groups or None, figures=figures)
    if not groups or COST in groups:
        rows += bench_cost(SHORT_COST_S if short else COST_S)
    return [asdict(row) for row in rows]


def _images(short: bool, figures: str | None) -> Rows:
    from tests.bench.estimator_images import bench_images

    rows = list(bench_images(short))
    if figures is not None:
        from tests.bench.estimator_plots import draw_images

        tell(str(draw_images(rows, figures)))
    return [asdict(row) for row in rows]


def _attitude(short: bool, data: Path | None, seeds: range | None, *, as_json: bool) -> None:
    """Print the table and the median; exit code 1 if a bar is not kept."""
    from tests.bench.attitude import INCLINATION_BAR_DEG, bench_attitude, median_inclination
    from tests.bench.attitude_recordings import FOLDER, load_trials

    folder = FOLDER if data is None else data
    if not load_trials(folder):
        tell(f"no recorded trials in {folder}: made-up motions only; give --data FOLDER")
    rows = bench_attitude(short, folder, seeds)
    median = median_inclination(rows)
    table = [asdict(row) for row in rows]

    def show() -> None:
        print_rows(TITLES["attitude"], table, HEADS)
        click.echo(f"median inclination {median:.2f} deg, asked <= {INCLINATION_BAR_DEG:g}")

    kept = not (median > INCLINATION_BAR_DEG or any(row.missed for row in rows))
    judge(kept, {"rows": table, "median_inclination": median}, show, as_json=as_json)


def pockets_rows(short: bool) -> Rows:
    """Goals behind pockets, cylinders on the line, staggered gaps.

    Reached from 60 starts each (five minutes; 6 starts with --short, or among all benchmarks).
    """
    from tests.bench.pockets import SHORT_STARTS, STARTS, bench_pockets

    return [asdict(row) for row in bench_pockets(SHORT_STARTS if short else STARTS)]


@click.command()
@SHORT
@click.option("--recompute", is_flag=True, help="Compute the optima anew first (minutes).")
@click.option("--case", "cases", multiple=True, help="Only this case: b1, 'b3 up', b4 ...; may be given again.")
@click.option("--figures", type=click.Path(file_okay=False), help="Write figures into this folder.")
@JSON
def energy(short: bool, recompute: bool, cases: tuple[str, ...], figures: str | None, as_json: bool) -> None:
    """Energy of closed loops beside the offline optimum.

    With known flow, and with an estimated flow and a wrong model; a quarter of an hour, one minute with --short or
    among all benchmarks.
    """
    from tests.bench.energy.cases import CASES

    for case in cases:
        if case not in CASES:
            raise click.BadParameter(f"{case!r} is no case; valid: {', '.join(CASES)}", param_hint="--case")
    if recompute:
        from tests.bench.energy.record import recompute as compute
        from tests.bench.energy.record import save_records

        save_records(compute(tell))
    run_one(
        "energy", TITLES["energy"], partial(energy_rows, cases=cases, figures=figures), short=short, as_json=as_json
    )


def energy_rows(short: bool, cases: tuple[str, ...] = (), figures: str | None = None) -> Rows:
    from tests.bench.energy.bench import bench_energy

    result = bench_energy(short, tell, cases)
    if figures is not None:
        from tests.bench.energy.figures import draw

        for path in draw(result.flights, figures):
            tell(str(path))
    return [asdict(row) for row in result.rows]


def latency_rows(short: bool) -> Rows:
    """CPU time of energy plans per kind of request.

    In the tank, a basin and open water, beside when their answers are due in lockstep (a minute or two; half with
    --short).
    """
    from tests.bench.energy.latency import RUNS, SHORT_RUNS, bench_latency

    return [asdict(row) for row in bench_latency(SHORT_RUNS if short else RUNS)]


def legs_rows(short: bool) -> Rows:
    """Time per energy plan on random legs, and legs without a plan.

    300 legs in basins of 5 to 500 m with pillars and uniform currents, quick plan and full search (five minutes; 20
    legs with --short).
    """
    from tests.bench.energy.legs import LEGS, SHORT_LEGS, bench_legs

    return [asdict(row) for row in bench_legs(SHORT_LEGS if short else LEGS)]


def rivals_rows(short: bool) -> Rows:
    """Short legs at shipped defaults: minimum energy, quadratic cost and los-pid.

    Beside the optimum of the vehicle that is flown: a jet beside the way, and upstream, with and without more drag and
    less thrust (ten minutes; one leg with --short).
    """
    from tests.bench.energy.rivals import bench_rivals

    return [asdict(row) for row in bench_rivals(short, tell)]


@click.command()
@SHORT
@click.option("--base", metavar="REV", help="The other revision (default: where this one departed from origin/main).")
@click.option("--turns", "count", type=click.IntRange(1), default=3, show_default=True, help="How often each flies.")
@JSON
def turns(short: bool, base: str | None, count: int, as_json: bool) -> None:
    """CPU time per tick of two revisions in turns.

    Each flies the missions of `autopilot bench sitl --short` in a process of its own, on this machine as it is now
    (some minutes; one turn with --short).
    """
    work = partial(turns_rows, base=base, count=count)
    run_one("turns", TITLES["turns"], work, short=short, as_json=as_json)


def turns_rows(short: bool, base: str | None = None, count: int = 1) -> Rows:
    from tests.bench.turns import base_revision, bench_turns

    return [asdict(row) for row in bench_turns(base or base_revision(), 1 if short else count)]


ROWS = {
    "pockets": pockets_rows,
    "energy-latency": latency_rows,
    "energy-legs": legs_rows,
    "energy-rivals": rivals_rows,
}
"""Studies without options of their own."""
