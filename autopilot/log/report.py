"""The HTML report: one file that opens anywhere without a network.

Header, verdicts, linked interactive plots, events, parameters and topics. The scripts that draw the plots are inlined,
so that the file loads nothing.
"""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path

from autopilot.core.errors import LogError
from autopilot.core.params import PARAMETERS
from autopilot.log.analysis import Flight, last_counts, load_flight, seconds
from autopilot.log.check import Row, Verdict, acceptance_table, format_figure, overall
from autopilot.log.reader import Log
from autopilot.log.visuals import ROS_LEVEL

_STYLE = """
body { font: 14px/1.45 system-ui, sans-serif; margin: 0 auto; max-width: 1150px; padding: 0 16px 48px; color: #222; }
h1 { font-size: 22px; margin: 20px 0 4px; } h2 { font-size: 17px; margin: 28px 0 8px; }
h3 { font-size: 14px; margin: 14px 0 0; }
table { border-collapse: collapse; } td, th { padding: 2px 12px 2px 0; text-align: left; vertical-align: top; }
th { border-bottom: 1px solid #999; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
.badge { display: inline-block; padding: 1px 9px; border-radius: 9px; color: #fff; font-weight: 600; }
.pass { background: #2e8b57; } .warn { background: #d08700; } .fail { background: #c62828; } .info { background: #888; }
tr.fail td { background: #fdecea; } tr.warn td { background: #fff6e0; }
.problem { border-left: 4px solid #c62828; padding: 4px 10px; background: #fdecea; }
details { margin: 8px 0; } summary { cursor: pointer; } .muted { color: #777; }
"""
_EVENTS_SHOWN = 500
_LEVEL_NAMES = {50: "fatal", 40: "error", 30: "warning", 20: "info", 10: "debug"}


def write_report(log: Log, path: Path) -> Path:
    """Write the report of a log. LogError if the log holds no track or the file cannot be written."""
    if path.is_dir():
        raise LogError(f"{path}: the report cannot be written (is a folder); give the name of a file")
    flight = load_flight(log)
    page = _page(flight, acceptance_table(log))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise LogError(f"{path}: the report cannot be written ({error.strerror}); choose another place") from error
    return path


def _page(flight: Flight, rows: Sequence[Row]) -> str:
    from bokeh.embed import components
    from bokeh.resources import Resources

    from autopilot.log.report_plots import Plots

    plots = Plots(flight).all()
    script, parts = components(plots)
    scripts = Resources(mode="inline", components=["bokeh"], log_level="warn").render_js()
    drawn = "".join(f"<h3>{html.escape(title)}</h3>\n{parts[title]}\n" for title in plots)
    title = f"{flight.run.scenario if flight.run is not None else flight.log.path.stem}: {flight.log.path.name}"
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>\n'
        f"<style>{_STYLE}</style>\n{scripts}</head>\n<body>\n<h1>{html.escape(title)} {_badge(overall(rows))}</h1>\n"
        f"{_problems(flight.log)}{_header(flight)}\n<h2>Bounds</h2>\n{_acceptance(rows)}\n"
        f"<h2>Plots</h2>\n{_modes(flight)}\n{drawn}\n<h2>Events</h2>\n{_events(flight.log)}\n"
        f"<h2>Counters</h2>\n{_counters(flight)}\n"
        f"<h2>Parameters</h2>\n{_parameters(flight)}\n<h2>Topics</h2>\n{_topics(flight.log)}\n{script}\n</body></html>\n"
    )


def _badge(verdict: Verdict) -> str:
    return f'<span class="badge {verdict.value}">{verdict.value}</span>'


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells are escaped here."""
    head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>\n" for row in rows)
    return f"<table><tr>{head}</tr>\n{body}</table>"


def _problems(log: Log) -> str:
    return "".join(f'<p class="problem">{html.escape(problem)}</p>\n' for problem in log.problems)


def _header(flight: Flight) -> str:
    """What the run was, in pairs."""
    run, log, armed = flight.run, flight.log, flight.armed
    track = flight.judged.between(armed)
    steps = track.pos_ned_m[1:] - track.pos_ned_m[:-1]
    pairs: list[tuple[str, str]] = [(key, value) for key, value in log.run.items() if key != "epoch_ns"]
    if run is not None:
        seed = "" if run.seed is None else str(run.seed)
        pairs = [("scenario", run.scenario), ("vehicle", run.vehicle), ("solver", run.solver), ("seed", seed), *pairs]
    pairs += [
        ("judged on", "truth" if flight.truth is not None else "estimate"),
        ("armed", f"{armed.start_s:.1f} s to {armed.end_s:.1f} s"),
        ("distance", f"{float(((steps**2).sum(axis=1) ** 0.5).sum()):.1f} m"),
        ("messages", f"{log.message_count} on {len(log.topics)} topics"),
    ]
    return _table(("", ""), list(dict(pairs).items()))


def _acceptance(rows: Sequence[Row]) -> str:
    out = ["<table><tr><th>bound</th><th>limit</th><th>worst</th><th>margin</th><th>unit</th><th>at [s]</th>"]
    out.append("<th>verdict</th><th></th></tr>\n")
    for row in rows:
        numbers = "".join(f'<td class="n">{format_figure(value)}</td>' for value in (row.limit, row.worst, row.margin))
        at = "" if row.at_s is None else f"{row.at_s:.2f}"
        out.append(
            f'<tr class="{row.verdict.value}"><td>{html.escape(row.name)}</td>{numbers}<td>{row.unit}</td>'
            f'<td class="n">{at}</td><td>{_badge(row.verdict)}</td>'
            f'<td class="muted">{html.escape(row.note)}</td></tr>\n'
        )
    return "".join(out) + "</table>"


def _modes(flight: Flight) -> str:
    """When which mode was in force."""
    mode = flight.table("/sys/mode")
    if mode is None:
        return ""
    names = flight.run.mode_names if flight.run is not None else {}
    rows: list[tuple[str, str]] = []
    last = ""
    for t_s, armed, number in zip(seconds(mode), mode["armed"], mode["custom_mode"], strict=True):
        text = names.get(str(number), f"mode {number}") if armed else "disarmed"
        if text != last:
            rows.append((f"{t_s:.2f}", text))
        last = text
    table = _table(("at [s]", "mode"), rows)
    return f"<details><summary>Modes ({len(rows)} changes, shaded in the plots)</summary>{table}</details>"


def _counters(flight: Flight) -> str:
    """What was counted by the end of the log, where it is not 0."""
    rows = [(name, str(count)) for name, count in last_counts(flight.log).items() if count]
    return _table(("", "times"), rows) if rows else "<p>none</p>"


def _events(log: Log) -> str:
    if "/rosout" not in log:
        return "<p>none</p>"
    messages = log.messages("/rosout")
    rows = [
        (f"{m.t_us * 1e-6:.2f}", _LEVEL_NAMES.get(m.value["level"], str(m.value["level"])), m.value["msg"])
        for m in messages[:_EVENTS_SHOWN]
    ]
    more = f"<p>{len(messages) - _EVENTS_SHOWN} more in the log</p>" if len(messages) > _EVENTS_SHOWN else ""
    return _table(("at [s]", "severity", "text"), rows) + more


def _parameters(flight: Flight) -> str:
    """All parameters, those that are not at their default first."""
    if flight.run is None or not flight.run.parameters:
        return "<p>not in the log</p>"
    specs = {spec.name: spec for spec in PARAMETERS}
    changed: list[tuple[str, ...]] = []
    same: list[tuple[str, ...]] = []
    for name, value in sorted(flight.run.parameters.items()):
        spec = specs.get(name)
        about = ("", "", "") if spec is None else (f"{spec.default:g}", spec.unit, spec.help)
        row = (name, f"{value:g}", *about)
        (same if spec is not None and abs(spec.default - value) <= 1e-6 * abs(value) else changed).append(row)
    columns = ("name", "value", "default", "unit", "")
    first = _table(columns, changed) if changed else "<p>all at their defaults</p>"
    return f"{first}<details><summary>{len(same)} at their defaults</summary>{_table(columns, same)}</details>"


def _topics(log: Log) -> str:
    rows = [(topic, info.type, str(info.count)) for topic, info in log.topics.items()]
    return f"<details><summary>{len(rows)} topics</summary>{_table(('topic', 'type', 'messages'), rows)}</details>"


assert set(ROS_LEVEL) == set(_LEVEL_NAMES), "every level that events are written with has a name"
