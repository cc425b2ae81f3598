"""The HTML report by its model tree: what is in view, aligned and marked; and in a browser, where there is one."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bokeh.models import BoxAnnotation, Plot, Range1d, Span
from browser_module import browser, needs_browser
from log_synthetic import Run, shifted, write_run

from autopilot.log.analysis import FlightRecord, load_flight
from autopilot.log.reader import open_log
from autopilot.log.report import write_report
from autopilot.log.report_draw import LEFT_PX, RIGHT_PX, Curve, TimeSheet, density, histogram
from autopilot.log.report_plots import Plots, aimed_yaw, per_second, same_turn, unwrapped_deg


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> FlightRecord:
    slow = shifted(9.0, 0.3, vel_water_frd_m_s=np.array([0.6, 0.0, 0.0]))
    run = Run(laps=1, step_us=100_000, full_inputs=True, change_truth=slow)
    return load_flight(open_log(write_run(tmp_path_factory.mktemp("report") / "run.mcap", run)))


@pytest.fixture(scope="module")
def subjects(flight: FlightRecord) -> dict[str, dict[str, Any]]:
    return Plots(flight).all()


@pytest.fixture(scope="module")
def page(flight: FlightRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(flight.log, tmp_path_factory.mktemp("page") / "a.html")


def over_time(subjects: dict[str, dict[str, Any]]) -> dict[str, Plot]:
    found = {title: plot for plots in subjects.values() for title, plot in plots.items()}
    return {title: plot for title, plot in found.items() if plot.xaxis[0].axis_label == "time [s]"}


def curves(plot: Plot) -> dict[str, Any]:
    """Name -> data of every curve."""
    sources = [renderer.data_source for renderer in plot.renderers]
    return {source.name: source.data for source in sources if source.name and source.name != "marks"}


def test_every_bound_is_in_view(subjects: dict[str, dict[str, Any]]) -> None:
    seen = 0
    for title, plot in over_time(subjects).items():
        assert isinstance(plot.y_range, Range1d), title
        for span in plot.select(Span):
            if span.dimension == "width":
                seen += 1
                assert plot.y_range.start < span.location < plot.y_range.end, title
    assert seen >= 20


def test_time_axes_are_one_and_aligned(subjects: dict[str, dict[str, Any]]) -> None:
    plots = over_time(subjects)
    assert len(plots) > 30
    assert len({plot.x_range.id for plot in plots.values()}) == 1
    for plot in plots.values():
        assert (plot.min_border_left, plot.min_border_right) == (LEFT_PX, RIGHT_PX)
        assert plot.toolbar_location == "above" and plot.right == []


def test_every_time_plot_has_mode_bands_and_marks(subjects: dict[str, dict[str, Any]]) -> None:
    for title, plot in over_time(subjects).items():
        assert plot.select(BoxAnnotation), title
        marks = [r.data_source for r in plot.renderers if r.data_source.name == "marks"]
        assert marks and 12.0 in list(marks[0].data["t"]), f"{title}: the parameter's change is not marked"
    texts = curves(subjects["Overview"]["Modes and events"])["events"]["text"]
    assert "MPC_Q_POS = 25" in texts and "lap 0" in texts


def test_set_points_and_axes_of_their_own(subjects: dict[str, dict[str, Any]]) -> None:
    tracking = subjects["Tracking"]
    for title in ("x, north", "y, east", "z, depth"):
        assert {"truth", "estimate", "set point"} <= set(curves(tracking[title]))
    assert float(curves(tracking["x, north"])["set point"]["y"][0]) == pytest.approx(1.75)
    assert all(name.startswith("yaw") is False for name in curves(tracking["Roll and pitch"]))
    assert set(curves(tracking["Yaw"])) >= {"truth", "estimate"}


@pytest.mark.parametrize("turns", [-3, -1, 0, 2])
def test_headings_that_were_reached_are_drawn_on_the_vehicles_turn(turns: int) -> None:
    """To and fro by half a turn, with the other way round in between, from any turn on."""
    reached = 360.0 * turns + np.array([0.0, -180.0, -360.0, -180.0, 0.0, 180.0, 360.0])
    yaw = np.interp(np.arange(61.0), np.arange(7.0) * 10.0, reached)
    aimed = np.repeat((reached[1:] + 180.0) % 360.0 - 180.0, 10)
    found = aimed_yaw(np.append(aimed, aimed[-1]), yaw)
    np.testing.assert_array_equal(found[:-1], np.repeat(reached[1:], 10))


def test_free_headings_are_gaps() -> None:
    aimed = np.array([0.0, 0.0, np.nan, np.nan, 170.0, 170.0])
    found = aimed_yaw(aimed, np.array([350.0, 355.0, 360.0, 400.0, 450.0, 529.0]))
    np.testing.assert_array_equal(found, [360.0, 360.0, np.nan, np.nan, 530.0, 530.0])


def test_truth_and_estimate_are_on_one_turn() -> None:
    """Of a heading about south one begins at 180, the other at -180 degrees; an estimate may begin without one."""
    t_s = np.arange(5.0)
    truth = Curve(name="truth", t_s=t_s, values=unwrapped_deg(np.radians([179.0, 180.0, -179.0, -178.0, -177.0])))
    late = unwrapped_deg(np.radians([np.nan, -180.0, -179.0, -178.0, -177.0]))
    np.testing.assert_allclose(truth.values, [179.0, 180.0, 181.0, 182.0, 183.0])
    np.testing.assert_allclose(
        same_turn(Curve(name="estimate", t_s=t_s, values=late), truth), [np.nan, 180.0, 181.0, 182.0, 183.0]
    )


def test_every_axis_has_its_unit(subjects: dict[str, dict[str, Any]]) -> None:
    for plots in subjects.values():
        for title, plot in plots.items():
            for axis in (*plot.xaxis, *plot.yaxis):
                assert not axis.visible or re.search(r"\[.+\]$", axis.axis_label), (title, axis.axis_label)


def test_a_plot_without_a_line_in_its_time_is_left_out() -> None:
    sheet, t_s = TimeSheet(0.0, 10.0, (), ()), np.arange(10.0)
    made = {
        "seen": Curve(name="", t_s=t_s, values=t_s),
        "outside": Curve(name="", t_s=t_s + 20.0, values=t_s),
        "a point": Curve(name="", t_s=t_s, values=np.where(t_s == 3.0, 1.0, np.nan)),
        "unknown": Curve(name="", t_s=t_s, values=np.full(10, np.nan)),
    }
    assert [name for name, curve in made.items() if sheet.plot("a [m]", [curve]) is not None] == ["seen"]


def test_the_legend_of_the_plan_shows_an_arrow_and_hides_all_of_them(subjects: dict[str, dict[str, Any]]) -> None:
    (legend,) = subjects["Overview"]["Plan"].legend
    (key,) = next(item.renderers for item in legend.items if item.label.value == "direction of travel")
    assert key.glyph.marker == "triangle" and "change:visible" in key.js_property_callbacks


def test_plan_laps_and_failures_come_first_and_the_rest_is_folded(page: Path, flight: FlightRecord) -> None:
    text = page.read_text(encoding="utf-8")
    body = text[text.index("<body>") :]
    head, *sections = body.split('<details class="section"')
    assert head.index("<h3>Plan") < head.index('<tr class="row-fail"><td>') < head.index("<th>energy [J]</th>")
    assert head.count("<tr") == 1 + 12 + 2 and head.count("data-root-id") == 2
    assert all("open>" not in section.partition(">")[0] for section in sections)
    names = re.findall(r'<details class="section" id="([^"]+)"', body)
    assert names[0] == "verdicts" and [f"#{name}" for name in names] == re.findall(r'<a href="(#[^"]+)"', body)


@pytest.mark.long
@needs_browser
@pytest.mark.parametrize("width_px", [390, 1440])
def test_the_page_is_as_wide_as_its_screen(page: Path, width_px: int) -> None:
    """In a browser: a link opens its section, every plot is drawn and fits, and nothing is wrong on the console."""
    with browser.page(browser.found()) as shown:
        shown.size(width_px, 844, phone=width_px < 600)
        shown.open(f"{page.as_uri()}#thrusters")
        shown.wait("document.readyState === 'complete' && document.getElementById('thrusters')?.open")
        shown.ask("unfold()")
        boxes = "[...document.querySelectorAll('[data-root-id] > *')].map((plot) => plot.getBoundingClientRect())"
        shown.wait(f"{boxes}.length >= {page.read_text(encoding='utf-8').count('data-root-id')}")
        shown.wait(f"{boxes}.every((box) => box.width > {0.35 * width_px} && box.right <= {width_px})")
        assert shown.ask("document.documentElement.scrollWidth") == width_px
        assert shown.errors == []


def test_the_histogram_holds_the_longest_step_and_the_deadline() -> None:
    values = np.concatenate([np.full(5000, 0.8), [180.0]])
    plot = histogram("ms", values, 50.0, "deadline")
    assert plot is not None
    assert plot.x_range.start < 0.8 and plot.x_range.end > 180.0
    bars = plot.renderers[0].data_source.data
    assert sum(bars["y"]) == len(values) and max(bars["right"]) > 180.0
    (legend,) = plot.legend
    assert {item.label.value for item in legend.items} == {"median 0.8", "p99 0.8", "longest 180", "deadline 50"}


def test_spectra_show_what_swings() -> None:
    t_s = np.arange(0.0, 30.0, 0.01)
    found = density(t_s, 2.0 * np.sin(2.0 * np.pi * 7.0 * t_s) + 5.0)
    assert found is not None
    hz, power = found
    assert hz[int(power.argmax())] == pytest.approx(7.0, abs=0.15)
    assert float(np.sum(power) * (hz[1] - hz[0])) == pytest.approx(2.0, rel=0.05)  # variance of the sine
    assert density(t_s[:20], t_s[:20]) is None


def test_messages_are_counted_in_each_second_and_a_silence_of_decades_is_drawn_at_once() -> None:
    at_s, counts = per_second(np.array([100, 900_000, 1_200_000, 4_000_000, 4_000_001, 2 * 10**15]))
    assert at_s.tolist() == [0.0, 1.0, 2.0, 4.0, 5.0, 2e9]
    assert counts.tolist() == [2.0, 1.0, 0.0, 2.0, 0.0, 1.0]


def test_rows_are_tinted_and_notes_can_be_read(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    (style,) = re.findall(r"<style>(.*?)</style>", text, re.S)
    filled = re.findall(r"([^{}]*)\{[^}]*background: #(?:2e8b57|8a8a8a|c62828|b36b00)", style)
    assert filled and all(".badge" in selector for selector in filled)
    assert '<tr class="row-fail">' in text and '<td class="note">reached' in text
    assert text.count("<figure>") == 10 and "data:image/jpeg" in text
    assert "</a> <a" in text, "the line of links can be broken"
    for name in ("verdicts.csv", "parameters.params", "run.json"):
        assert f'download="{name}"' in text
