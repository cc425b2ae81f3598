"""``autopilot log replay``: replay a logged run, unchanged or with changes."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.click_types import Finite, OneOf
from autopilot.cli.console_output import EXIT_FAILED, EXIT_LOSS, emit_json, print_table
from autopilot.cli.service_options import part_name
from autopilot.cli.shared_options import JSON_NOT_TABLES, LOG_FILE, not_over

if TYPE_CHECKING:
    from collections.abc import Sequence

    from autopilot.analysis.flight_figures import Moved
    from autopilot.log.reader import Log
    from autopilot.replay.service_replay import ReplayResult

SHOWN = 20
"""Differences that are printed."""


@click.command()
@LOG_FILE
@click.option("--step", "step_s", type=Finite(), metavar="T", help="Take apart the control step at T seconds.")
@click.option("--figure", type=click.Path(path_type=Path), help="--step: PNG to draw (default: LOG_step_T.png).")
@click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="NAME=VALUE",
    help="What if: simulate LOG's run again with another parameter (MPC_...), or give its inputs to an estimator "
    "with another option (model_aid ...); repeatable.",
)
@click.option("--open-loop", is_flag=True, help="--set: the recorded inputs instead of a simulation.")
@click.option("--only", type=OneOf(("estimator",)), help="Replay the estimator alone.")
@click.option("--estimator", callback=part_name, help="The estimator alone: another one than the run's.")
@click.option("--out", type=click.Path(path_type=Path), help="Keep what was replayed: .mcap (estimator: or .csv).")
@JSON_NOT_TABLES
def replay(
    log_file: Path,
    step_s: float | None,
    figure: Path | None,
    changes: tuple[str, ...],
    open_loop: bool,
    only: str | None,
    estimator: str | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Give LOG's inputs to the whole service again and compare all that comes out, bit for bit.

    Exit 1 if anything differs (the first difference of each field is named), 3 if LOG ends before its run did.
    """
    from autopilot.log.reader import open_log

    # Options of the estimator are small, parameters are large.
    parameters = tuple(text for text in changes if text[:1].isupper())
    if parameters and (len(parameters) < len(changes) or only or estimator or step_s is not None):
        raise click.UsageError("--set with parameters goes with neither estimator options nor --step")
    if open_loop and not parameters:
        raise click.UsageError("--open-loop needs --set NAME=VALUE with a parameter")
    not_over(out, log_file)
    not_over(figure, log_file)
    opened = open_log(log_file)
    if step_s is not None:
        _take_apart(opened, step_s, figure, as_json=as_json)
    elif parameters:
        _what_if(opened, parameters, out, in_open_loop=open_loop, as_json=as_json)
    elif only or estimator or changes:
        _estimator_alone(opened, estimator, changes, out, as_json=as_json)
    else:
        from autopilot.replay.service_replay import replay_service

        _tell_versions(opened)
        _tell(opened, replay_service(opened, out=out), as_json=as_json)


def _take_apart(opened: "Log", step_s: float, figure: Path | None, *, as_json: bool) -> None:
    """One control step: active limits, distance from the converged plan, and the alternatives around each obstacle."""
    from autopilot.analysis.step_figure import write_step_figure
    from autopilot.analysis.step_replay import inspect_step, worst

    view = inspect_step(opened, step_s)
    path = figure or opened.path.with_name(f"{opened.path.stem}_step_{view.t_s:.2f}.png")
    write_step_figure(view, path)
    apart, status = worst(view), view.output.status
    if as_json:
        others = [{"obstacle": o.obstacle, "side": o.side, "way_m": o.way_m, "other_m": o.other_m} for o in view.others]
        emit_json(
            {
                "log": str(opened.path),
                "t_s": view.t_s,
                "status": status.status.name,
                "fallback": status.fallback.name,
                "qps": status.iterations,
                "thrust_n": view.output.thrust_n.tolist(),
                "converged": view.converged,
                "rounds": view.rounds,
                "cost": view.plan_cost,
                "converged_cost": view.best_cost,
                "apart": apart,
                "limits": [asdict(limit) for limit in view.limits],
                "other_sides": others,
                "figure": str(path),
            }
        )
        return
    click.echo(
        f"{opened.path}: control step at {view.t_s:.2f} s: {status.status.name}, {status.iterations} QP, "
        f"fallback {status.fallback.name}"
    )
    forces = ", ".join(
        f"{name} {force:.2f}" for name, force in zip(view.thrusters, view.output.thrust_n.tolist(), strict=True)
    )
    click.echo(f"thrust [N]: {forces}")
    north, east, down = view.goal.pos_ned_m.tolist()
    click.echo(f"goal: N {north:.2f} E {east:.2f} D {down:.2f}, item {view.goal.seq}; plan: {view.grid_t_s[-1]:.1f} s")
    how = f"converged in {view.rounds} rounds" if view.converged else f"not converged in {view.rounds} rounds"
    click.echo(
        f"real-time step against IPOPT ({how}): cost {view.plan_cost:.4g} against {view.best_cost:.4g}, "
        f"place {1e3 * apart['place_m']:.1f} mm, first thrust {apart['first_thrust_n']:.3f} N apart"
    )
    limits = [
        (one.name, one.value, f"{one.from_s:.2f}", f"{one.to_s:.2f}", f"{one.multiplier:.3g}") for one in view.limits
    ]
    if limits:
        print_table("limits that hold the plan", ("limit", "value", "from, s", "to, s", "multiplier"), limits)
    else:
        click.echo("no limit holds the plan")
    sides = [
        (
            one.obstacle,
            one.side,
            f"{one.way_m:.2f}",
            "-" if one.other_m is None else f"{one.other_m:.2f}",
            "no such way" if one.other_m is None else f"{one.other_m - one.way_m:+.2f}",
        )
        for one in view.others
    ]
    if sides:
        print_table(
            "obstacles beside the way: how long it would be on their other side",
            ("obstacle", "passed to", "way, m", "other side, m", "difference, m"),
            sides,
        )
    click.echo(str(path))


def _what_if(opened: "Log", texts: tuple[str, ...], out: Path | None, *, in_open_loop: bool, as_json: bool) -> None:
    """The same run with other parameters."""
    from autopilot.analysis.what_if import closed_loop, open_loop, read_changes

    changes = read_changes(opened, texts)
    if in_open_loop:
        flat = open_loop(opened, changes, out)
        if as_json:
            emit_json({"log": str(opened.path), "loop": "open", **asdict(flat)})
            return
        _tell_changes(opened, "open loop: the recorded inputs, so the motion is that of the log", flat.changes)
        click.echo(
            f"{flat.steps} control steps: thrust rms {flat.rms_before_n:.3f} N then, {flat.rms_after_n:.3f} N now, "
            f"difference rms {flat.rms_n:.3f} N, largest {flat.largest_n:.2f} N at {flat.largest_at_s:.2f} s"
        )
        return
    found = closed_loop(opened, changes, out)
    if as_json:
        emit_json({"log": str(opened.path), "loop": "closed", **asdict(found)})
        return
    _tell_changes(opened, "closed loop: simulated again", found.changes)
    print_table("figures", ("figure", "then", "now", "change"), moved_rows(found.moved))
    for remark in found.remarks:
        click.echo(f"note: {remark}", err=True)


def moved_rows(moved: "Sequence[Moved]") -> list[tuple[str, str, str, str]]:
    """Rows of a table of figures: then, now, change."""
    return [
        (
            one.figure,
            "-" if one.before is None else f"{one.before:.6g}",
            "-" if one.after is None else f"{one.after:.6g}",
            "" if one.same else "new" if one.relative_change is None else f"{100.0 * one.relative_change:+.2f} %",
        )
        for one in moved
    ]


def _tell_changes(opened: "Log", how: str, changes: "Sequence[tuple[str, float, float]]") -> None:
    click.echo(f"{opened.path}, {how}")
    for name, then, now in changes:
        click.echo(f"  {name} = {now:g} (was {then:g})")


def _tell_versions(opened: "Log") -> None:
    """Warn of another version: only the same one is expected to give identical results."""
    from autopilot.run.provenance import revision

    then, now = opened.run.get("revision", ""), revision()
    if then != now:
        text = f"LOG is of revision {then or 'unknown'}, this is {now or 'unknown'}: differences may be theirs"
        click.echo(f"note: {text}", err=True)


def _tell(opened: "Log", result: "ReplayResult", *, as_json: bool) -> None:
    if as_json:
        listed = [asdict(one) for one in result.differences]
        emit_json({**asdict(result), "log": str(opened.path), "same": result.same, "differences": listed})
    else:
        verdict = "all the same" if result.same else f"{len(result.differences)} fields differ"
        click.echo(
            f"{opened.path}: {result.ticks} ticks, {result.messages} messages of {result.topics} topics: {verdict}"
        )
        for difference in result.differences[:SHOWN]:
            click.echo(f"  {difference}")
        if len(result.differences) > SHOWN:
            click.echo(f"  and {len(result.differences) - SHOWN} more (--json lists all)")
    for remark in result.remarks:
        click.echo(f"not compared: {remark}", err=True)
    _end(opened, result.same, *((result.stopped,) if result.stopped else ()))


def _end(opened: "Log", same: bool, *stopped: str) -> None:
    """Warn of what was not replayed; the exit code."""
    problems = (*opened.problems, *stopped)
    for problem in problems:
        click.echo(f"warning: {opened.path}: {problem}; replayed is what comes before", err=True)
    if not same:
        raise click.exceptions.Exit(EXIT_FAILED)
    if problems:
        raise click.exceptions.Exit(EXIT_LOSS)


def _estimator_alone(
    opened: "Log", estimator: str | None, changes: tuple[str, ...], out: Path | None, *, as_json: bool
) -> None:
    """The estimator's replay: bit for bit, or how far another one is from the log and both from the truth."""
    from autopilot.record.estimator_setup import read_setup
    from autopilot.replay import estimator_replay as replaying

    setup = replaying.replay_setup(opened, estimator, changes)
    states = replaying.replay(opened, setup)
    changed = setup != read_setup(opened)
    found = replaying.matches(opened, states)
    if out is not None:
        replaying.write_replay(out, opened, states)
    spreads = replaying.spreads(opened, states) if changed else []
    if as_json:
        same = all(match.same for match in found)
        listed = [{**asdict(match), "same": match.same} for match in found]
        rows = [asdict(row) for row in spreads]
        emit_json({"log": str(opened.path), "same": same, "topics": listed, "spreads": rows})
    elif changed:
        title = f"{opened.path}: replayed with {setup.name}{''.join(f', {change}' for change in changes)} (rms)"
        columns = ("quantity", "unit", "replayed - logged", "logged - truth", "replayed - truth")
        figures = [(row.difference, row.logged_error, row.replayed_error) for row in spreads]
        print_table(
            title,
            columns,
            [
                (row.quantity, row.unit, *("-" if value is None else f"{value:.4f}" for value in values))
                for row, values in zip(spreads, figures, strict=True)
            ],
        )
    else:
        for match in found:
            click.echo(f"{match.topic}: {match.identical} of {match.logged} messages identical")
            if match.first:
                click.echo(f"  first difference {match.first}")
    _end(opened, changed or all(match.same for match in found))
