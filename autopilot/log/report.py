"""The HTML report: one self-contained file, no network needed.

Plan, main figures and laps first; verdicts, linked interactive plots, events, parameters and topics are folded. The
plotting scripts are inlined.
"""

import base64
import csv
import html
import io
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from autopilot.core.disk import make_folder, write_whole
from autopilot.core.errors import LogError
from autopilot.core.params import PARAMETERS
from autopilot.log.analysis import (
    TOPICS_OF_INTEREST,
    FlightRecord,
    energy_j,
    flown_laps,
    last_counts,
    load_flight,
    seconds,
)
from autopilot.log.check import BoundRow, BoundVerdict, acceptance_table, format_figure, overall, short_form
from autopilot.log.check_more import path_length_m
from autopilot.log.reader import DecodedMessage, Log
from autopilot.log.topics import AID_PREFIX
from autopilot.log.visuals import ROS_LEVEL

_STYLE = """
body { font: 14px/1.45 system-ui, sans-serif; margin: 0 auto; max-width: 1180px; padding: 0 16px 48px; color: #222; }
h1 { font-size: 22px; margin: 20px 0 8px; }
h3 { font-size: 14px; margin: 18px 0 0; } h3 button { font: 11px system-ui, sans-serif; margin-left: 8px; }
table { border-collapse: collapse; } td, th { padding: 2px 12px 2px 4px; text-align: left; vertical-align: top; }
th { border-bottom: 1px solid #999; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
.facts { columns: 2; } .facts div { break-inside: avoid; } .facts b { display: inline-block; width: 11em; }
.facts b { font-weight: normal; color: #666; }
.badge { display: inline-block; padding: 0 9px; border-radius: 9px; color: #fff; font-weight: 600; font-size: 12px; }
.badge { white-space: nowrap; } h1 .badge { font-size: 16px; }
.badge.pass { background: #257a4b; } .badge.warn { background: #a86400; } .badge.fail { background: #c62828; }
.badge.info { background: #6e6e6e; }
tr.row-fail td { background: #fdecea; } tr.row-warn td { background: #fff6e0; } tr.subject th { padding-top: 12px; }
td.note { color: #555; }
.problem { border-left: 4px solid #c62828; padding: 4px 10px; background: #fdecea; }
.strip { display: flex; flex-wrap: wrap; gap: 8px; } .strip figure { margin: 0; font-size: 12px; color: #555; }
.top { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: 24px; } div.note { font-size: 12px; }
.top td, .top th { padding-right: 6px; } .top table { margin-bottom: 16px; } div.note { color: #555; }
nav { margin: 20px 0; } nav a { margin-right: 12px; white-space: nowrap; }
details { margin: 8px 0; } summary { cursor: pointer; }
details.section { border-top: 1px solid #ddd; margin: 0; } .section > summary { font-size: 18px; padding: 8px 0; }
@media (max-width: 860px) { .top { grid-template-columns: minmax(0, 1fr); } }
@media (max-width: 640px) { .facts { columns: 1; } .section table { display: block; overflow-x: auto; }
body { padding: 0 8px 32px; } h1, td:first-child { overflow-wrap: anywhere; }
.section td:first-child { min-width: 9em; } }
"""
_SCRIPT = """
function saveCsv(id, name) {
  const plot = Bokeh.documents.map(d => d.get_model_by_id(id)).find(p => p);
  const rows = ["curve,t_or_x,value"];
  for (const r of plot.renderers) {
    const s = r.data_source;
    if (!s || !s.name || s.name == "marks" || !s.data.t || !s.data.y) continue;
    const label = s.name.replaceAll('"', "'");
    for (let i = 0; i < s.data.t.length; i++) rows.push(`"${label}",${s.data.t[i]},${s.data.y[i]}`);
  }
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([rows.join("\\n")], {type: "text/csv"}));
  link.download = name + ".csv";
  link.click();
}
function unfold(only) {
  for (const part of document.querySelectorAll("details")) if (!only || part == only) part.open = true;
}
function goTo() {
  const part = document.getElementById(location.hash.slice(1));
  if (part) { unfold(part); part.scrollIntoView(); }
}
addEventListener("hashchange", goTo);
addEventListener("load", goTo);
addEventListener("beforeprint", () => unfold());
"""
"""Plots save themselves as PNG (their toolbar); this saves what they show, and opens what a link leads to."""
_PICTURES, _PICTURE_PX = 10, 220
_JPEG = b"\xff\xd8\xff"
"""How a JPEG begins."""
_ATTACHED_BYTES = 100_000
"""Larger attachments stay in the log."""
_EVENTS_SHOWN = 500
_LAPS_SHOWN = 8
"""More are folded."""
_REPORTED_LEVEL = 20
"""Events below this level of rcl_interfaces/Log are no operator's business."""
_LEVEL_NAMES = {50: "fatal", 40: "error", 30: "warning", 20: "info", 10: "debug"}


def write_report(log: Log, path: Path) -> Path:
    """Write the HTML report of a log.

    Parameters
    ----------
    log
        The log.
    path
        File to write; its folder is created if it is missing.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    LogError
        The log holds no track, or the file cannot be written.
    """
    from autopilot.log.report_plots import TOPICS

    if path.is_dir():
        raise LogError(f"{path}: the report cannot be written (is a folder); give the name of a file")
    aids = [topic for topic in log.topics if topic.startswith(AID_PREFIX)]
    log.load([*TOPICS_OF_INTEREST, *TOPICS, *aids])  # one pass over the file for everything
    flight = load_flight(log)
    try:
        make_folder(path.parent)
    except OSError as error:
        raise LogError(f"{path.parent}: cannot be made ({error.strerror}); choose another place") from error
    page = _page(flight, acceptance_table(log))
    try:
        write_whole(path, page)
    except OSError as error:
        raise LogError(f"{path}: the report cannot be written ({error.strerror}); choose another place") from error
    return path


def _page(flight: FlightRecord, rows: Sequence[BoundRow]) -> str:
    from bokeh.document import Document
    from bokeh.embed import components
    from bokeh.resources import Resources

    from autopilot.log.report_plots import Plots

    subjects = Plots(flight).all()
    plots = {f"{subject}: {title}": plot for subject, found in subjects.items() for title, plot in found.items()}
    document = Document()
    with document.models.freeze():  # else every plot is scanned again for each of the others
        for plot in plots.values():
            document.add_root(plot)
    script, parts = components(plots)
    scripts = Resources(mode="inline", components=["bokeh"], log_level="warn").render_js()
    figures = {name: parts[name] for name in plots}
    for name, plot in plots.items():
        file = _anchor(f"{flight.log.path.stem} {name.partition(': ')[2]}")
        button = f"<button onclick=\"saveCsv('{plot.id}', '{file}')\">CSV</button>"
        figures[name] = f"<h3>{html.escape(name.partition(': ')[2])}{button}</h3>\n{parts[name]}\n"
    overview = [figures.pop(f"Overview: {title}") for title in subjects.pop("Overview")]
    scenario = "" if flight.run is None else flight.run.scenario
    title = f"{scenario or flight.log.path.stem}: {flight.log.path.name}"
    folded = {"Verdicts": _acceptance(rows), "Run": _header(flight, rows), "Modes": _modes(flight)}
    for subject, found in subjects.items():
        pictures = _pictures(flight.log) if subject == "Camera" else ""
        folded[subject] = pictures + "".join(figures[f"{subject}: {title}"] for title in found)
    folded |= {"Events": _events(flight.log), "Counters": _counters(flight), "Parameters": _parameters(flight)}
    folded |= {"Topics": _topics(flight.log), "Downloads": _downloads(flight, rows)}
    sections = "".join(
        f'<details class="section" id="{_anchor(name)}"><summary>{html.escape(name)}</summary>\n{content}</details>\n'
        for name, content in folded.items()
        if content
    )
    links = " ".join(f'<a href="#{_anchor(name)}">{html.escape(name)}</a>' for name in folded if folded[name])
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>{_STYLE}</style>\n{scripts}<script>{_SCRIPT}</script></head>\n<body>\n"
        f"<h1>{html.escape(title)} {_badge(overall(rows))}</h1>\n{_problems(flight.log)}"
        f'<div class="top"><div>{overview[-1]}</div>\n<div>{_in_short(rows)}\n{_laps(flight)}</div></div>\n'
        f'{"".join(overview[:-1])}<nav>{links} <button onclick="unfold()">unfold all</button></nav>\n'
        f"{sections}{script}\n</body></html>\n"
    )


def _in_short(rows: Sequence[BoundRow]) -> str:
    """What fails, what warns, and the most important rows."""
    out = ["<table><tr><th>quantity</th><th>worst</th><th>limit</th><th></th></tr>\n"]
    for row in short_form(rows):
        note = f'<div class="note">{html.escape(row.note)}</div>' if row.note else ""
        worst = f"{format_figure(row.worst)} {row.unit}"
        out.append(
            f'<tr class="row-{row.verdict.value}"><td>{html.escape(row.name)}{note}</td><td class="n">{worst}</td>'
            f'<td class="n">{format_figure(row.limit)}</td><td>{_badge(row.verdict)}</td></tr>\n'
        )
    return "".join(out) + "</table>"


def _laps(flight: FlightRecord) -> str:
    """Time and energy of every lap, empty without laps."""
    laps = flown_laps(flight)
    if not laps:
        return ""
    used = [energy_j(flight, lap) for lap in laps]
    cells = [
        (str(number), f"{lap.end_s - lap.start_s:.1f}", "-" if joules is None else f"{joules:.0f}")
        for number, (lap, joules) in enumerate(zip(laps, used, strict=True), 1)
    ]
    table = _table(("lap", "time [s]", "energy [J]"), cells)
    more = len(laps) > _LAPS_SHOWN
    return f"<details><summary>{len(laps)} laps</summary>{table}</details>" if more else table


def _anchor(title: str) -> str:
    """A title as a name in addresses and of files."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _pictures(log: Log) -> str:
    """Some of the pictures of the flight, evenly in time; empty without any."""
    if "/in/camera" not in log:
        return ""
    import cv2
    import numpy as np

    found = log.raw_messages("/in/camera")
    parts = []
    for time_ns, data in found[:: max(1, -(-len(found) // _PICTURES))]:
        start = data.find(_JPEG)
        pixels = None if start < 0 else cv2.imdecode(np.frombuffer(data[start:], np.uint8), cv2.IMREAD_COLOR)
        if pixels is None:
            continue
        height = max(1, round(pixels.shape[0] * _PICTURE_PX / pixels.shape[1]))
        small = cv2.resize(pixels, (_PICTURE_PX, height), interpolation=cv2.INTER_AREA)
        done, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 70])
        if done:
            at = f"{1e-9 * (time_ns - log.epoch_ns):.1f} s"
            source = f"data:image/jpeg;base64,{base64.b64encode(jpeg.tobytes()).decode()}"
            parts.append(f'<figure><img src="{source}" alt="camera at {at}"><figcaption>{at}</figcaption></figure>')
    return f'<div class="strip">{"".join(parts)}</div>\n'


def _downloads(flight: FlightRecord, rows: Sequence[BoundRow]) -> str:
    """Tables of this page and attachments of the log, as embedded files."""
    columns = ("subject", "name", "unit", "limit", "worst", "margin", "verdict", "at_s", "note")
    verdicts = [{**asdict(row), "verdict": row.verdict.value} for row in rows]
    text = io.StringIO()
    writer = csv.DictWriter(text, columns)
    writer.writeheader()
    writer.writerows({name: row[name] for name in columns} for row in verdicts)
    files = {"verdicts.csv": text.getvalue().encode()}
    if flight.run is not None:
        lines = "".join(f"{name} {value:.9g}\n" for name, value in sorted(flight.run.parameters.items()))
        files["parameters.params"] = lines.encode()
    attached = flight.log.attachments
    files |= {name: attached[name] for name in sorted(attached) if len(attached[name]) <= _ATTACHED_BYTES}
    items = "".join(
        f'<li><a download="{html.escape(name)}" href="data:application/octet-stream;base64,'
        f'{base64.b64encode(data).decode()}">{html.escape(name)}</a> ({len(data)} bytes)</li>'
        for name, data in files.items()
    )
    return f"<ul>{items}</ul>"


def _badge(verdict: BoundVerdict) -> str:
    return f'<span class="badge {verdict.value}">{verdict.value}</span>'


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>\n" for row in rows)
    return f"<table><tr>{head}</tr>\n{body}</table>"


def _problems(log: Log) -> str:
    return "".join(f'<p class="problem">{html.escape(problem)}</p>\n' for problem in log.problems)


def _header(flight: FlightRecord, rows: Sequence[BoundRow]) -> str:
    """Description of the run, in pairs."""
    run, log, armed = flight.run, flight.log, flight.armed
    track = flight.judged.between(armed)
    pairs: list[tuple[str, str]] = [(key, value) for key, value in log.run.items() if key != "epoch_ns"]
    if run is not None:
        seed = "" if run.seed is None else str(run.seed)
        pairs = [("scenario", run.scenario), ("vehicle", run.vehicle), ("solver", run.solver), ("seed", seed), *pairs]
    pairs += [
        ("judged on", "truth" if flight.truth is not None else "estimate"),
        ("armed", f"{armed.start_s:.1f} s to {armed.end_s:.1f} s"),
        ("path length", f"{path_length_m(track):.1f} m in {armed.end_s - armed.start_s:.1f} s"),
        ("fastest", f"{float(track.planar_speed_m_s.max(initial=0.0)):.2f} m/s in the water"),
        ("messages", f"{log.message_count} on {len(log.topics)} topics"),
    ]
    used = energy_j(flight, armed)
    if used is not None:
        pairs.append(("energy", f"{used:.0f} J"))
    counts = Counter(row.verdict.value for row in rows)
    pairs.append(("verdicts", ", ".join(f"{counts[v.value]} {v.value}" for v in BoundVerdict if counts[v.value])))
    cells = (f"<div><b>{html.escape(k)}</b>{html.escape(v)}</div>" for k, v in dict(pairs).items() if v)
    return f'<div class="facts">{"".join(cells)}</div>'


def _acceptance(rows: Sequence[BoundRow]) -> str:
    out = ["<table><tr><th>quantity</th><th>verdict</th><th>limit</th><th>worst</th><th>margin</th><th>unit</th>"]
    out.append("<th>at [s]</th><th></th></tr>\n")
    subject = ""
    for row in rows:
        if row.subject != subject:
            subject = row.subject
            out.append(f'<tr class="subject"><th colspan="8">{html.escape(subject)}</th></tr>\n')
        numbers = "".join(f'<td class="n">{format_figure(value)}</td>' for value in (row.limit, row.worst, row.margin))
        at = "" if row.at_s is None else f"{row.at_s:.2f}"
        out.append(
            f'<tr class="row-{row.verdict.value}"><td>{html.escape(row.name)}</td><td>{_badge(row.verdict)}</td>'
            f'{numbers}<td>{row.unit}</td><td class="n">{at}</td><td class="note">{html.escape(row.note)}</td></tr>\n'
        )
    return "".join(out) + "</table>"


def _modes(flight: FlightRecord) -> str:
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
    return f"<p>{len(rows)} changes, shaded in the plots</p>{table}"


def _counters(flight: FlightRecord) -> str:
    """Final values of the counters that are not 0."""
    rows = [(name, str(count)) for name, count in last_counts(flight.log).items() if count]
    return _table(("", "times"), rows) if rows else "<p>none</p>"


def _events(log: Log) -> str:
    if "/rosout" not in log:
        return "<p>none</p>"
    messages = log.messages("/rosout")
    reported = [message for message in messages if message.value["level"] >= _REPORTED_LEVEL]
    notes = [message for message in messages if message.value["level"] < _REPORTED_LEVEL]
    inner = f"<details><summary>{len(notes)} notes for developers</summary>{_event_table(notes)}</details>"
    return _event_table(reported) + (inner if notes else "")


def _event_table(messages: Sequence[DecodedMessage]) -> str:
    rows = [
        (f"{m.t_us * 1e-6:.2f}", _LEVEL_NAMES.get(m.value["level"], str(m.value["level"])), m.value["msg"])
        for m in messages[:_EVENTS_SHOWN]
    ]
    more = f"<p>{len(messages) - _EVENTS_SHOWN} more in the log</p>" if len(messages) > _EVENTS_SHOWN else ""
    return _table(("at [s]", "severity", "text"), rows) + more


def _parameters(flight: FlightRecord) -> str:
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
    return _table(("topic", "type", "messages"), rows)


assert set(ROS_LEVEL) == set(_LEVEL_NAMES), "every level that events are written with has a name"
