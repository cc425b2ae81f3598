"""Figures, report and the command line."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_synthetic import DESCRIPTION, EPOCH_NS, Run, call, shifted, write_run
from matplotlib.figure import Figure
from mcap.writer import Writer

from autopilot.cli.log import log as log_command
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.log import figure_tracks
from autopilot.log.analysis import Span
from autopilot.log.check import BoundRow, acceptance_table, format_figure, short_form
from autopilot.log.description import AcceptBounds
from autopilot.log.figures import BANDS, FIGURES, OVERLAID, write_figures
from autopilot.log.reader import open_log
from autopilot.log.report import write_report
from autopilot.log.report_draw import decimate
from autopilot.log.writer import LogWriter

ONE_LAP = replace(DESCRIPTION, accept=AcceptBounds(laps=1), parameters={"MPC_Q_POS": 1234.5, "HEARTBEAT": 1.0})


@pytest.fixture(scope="module")
def run_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = Run(laps=1, step_us=100_000, full_inputs=True, description=ONE_LAP)
    return write_run(tmp_path_factory.mktemp("outputs") / "run.mcap", run)


@pytest.fixture(scope="module")
def bad_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    change = shifted(9.0, 0.3, vel_water_frd_m_s=np.array([0.6, 0.0, 0.0]))
    run = Run(laps=1, step_us=200_000, description=ONE_LAP, change_truth=change)
    return write_run(tmp_path_factory.mktemp("outputs") / "bad.mcap", run)


def bare(path: Path) -> Path:
    LogWriter(path, epoch_ns=EPOCH_NS, metadata={}, attachments={}).close()
    return path


def test_a_log_without_failed_programs_says_so_and_a_damaged_one_is_named(run_log: Path, tmp_path: Path) -> None:
    code, out = call("programs", run_log)
    assert code == 0
    assert "every program was solved" in out
    code, out = call("programs", bare(tmp_path / "bare.mcap"))
    assert code == 0 and "has no control steps" in out
    path = tmp_path / "damaged.mcap"
    LogWriter(path, epoch_ns=EPOCH_NS, metadata={}, attachments={"program-01.npz": b"PK nonsense"}).close()
    code, out = call("programs", path)
    assert code == 1
    assert "program-01.npz" in out and "damaged" in out


@pytest.fixture(scope="module")
def figures(run_log: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """What ``autopilot log plot`` draws."""
    folder = tmp_path_factory.mktemp("figures")
    code, out = call("plot", run_log, "--out", folder)
    assert code == 0
    paths = [Path(line) for line in out.splitlines()]
    assert sorted(folder.iterdir()) == sorted(paths)
    for path in paths[1::2]:
        assert path.suffix == ".pdf" and path.read_bytes().startswith(b"%PDF-")
    return paths[::2]


@pytest.fixture(scope="module")
def report(run_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``autopilot log report`` writes."""
    path = tmp_path_factory.mktemp("report") / "deep" / "report.html"
    code, out = call("report", run_log, "--out", path)
    assert code == 0 and out.strip() == str(path)
    return path


def test_figures_are_drawn(figures: list[Path]) -> None:
    import cv2

    assert [path.stem for path in figures] == list(FIGURES)
    for path in figures:
        image = cv2.imread(str(path))
        assert image is not None and image.shape[1] == 1050
        assert image.std() > 10.0, f"{path.name} is blank"


def test_bounds_are_red_in_the_papers_figures(figures: list[Path]) -> None:
    import cv2

    for path in figures[:5]:
        image = cv2.imread(str(path))
        assert image is not None
        blue, green, red = (image[..., i].astype(int) for i in range(3))
        assert ((red > 240) & (green < 60) & (blue < 60)).sum() > 300, f"{path.name} has no bounds"


def test_figures_of_poor_logs(tmp_path: Path) -> None:
    poor = Run(laps=1, step_us=500_000, with_truth=False, description=replace(DESCRIPTION, waypoints=(), obstacles=()))
    paths = write_figures(open_log(write_run(tmp_path / "poor.mcap", poor)), tmp_path / "out")
    assert "6_estimate_error" not in {path.stem for path in paths} and "1_trajectory" in {path.stem for path in paths}
    with pytest.raises(LogError, match="neither"):
        write_figures(open_log(bare(tmp_path / "bare.mcap")), tmp_path)
    with pytest.raises(LogError, match="cannot be written"):
        write_figures(open_log(tmp_path / "poor.mcap"), tmp_path / "poor.mcap")


@pytest.mark.parametrize(
    ("paper", "columns", "width_in"),
    [("ieee", 1, 3.5), ("ieee", 2, 7.16), ("elsevier", 1, 3.54), ("elsevier", 2, 7.48)],
)
def test_figures_for_papers(run_log: Path, tmp_path: Path, paper: str, columns: int, width_in: float) -> None:
    """As wide as asked, with TrueType fonts (Type 42) in the file."""
    names = ("1_trajectory", "7_solve_time")
    asked = [word for name in names for word in ("--only", name)]
    code, out = call("plot", run_log, "--out", tmp_path, "--paper", paper, "--columns", columns, *asked)
    assert code == 0 and [Path(line).name for line in out.splitlines()[1::2]] == [f"{name}.pdf" for name in names]
    for path in map(Path, out.splitlines()[1::2]):
        data = path.read_bytes()
        box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+)", data)
        assert box is not None and float(box[1]) / 72.0 == pytest.approx(width_in, abs=0.01)
        assert b"/FontFile2" in data and b"/Type3" not in data


def test_several_logs_are_drawn_into_the_same_figures(run_log: Path, bad_log: Path, tmp_path: Path) -> None:
    poor = Run(laps=1, step_us=500_000, with_truth=False, description=replace(DESCRIPTION, waypoints=(), obstacles=()))
    other = write_run(tmp_path / "poor.mcap", poor)
    code, out = call("plot", run_log, bad_log, other, "--out", tmp_path / "all")
    assert code == 0
    assert [Path(line).stem for line in out.splitlines()[::2]] == list(OVERLAID)
    code, out = call("plot", run_log, other, "--only", "7_solve_time", "--out", tmp_path / "none")
    assert code == 2 and "7_solve_time" in out and "1_trajectory" in out and not (tmp_path / "none").exists()


def test_median_and_spread_of_several_logs(run_log: Path, bad_log: Path, tmp_path: Path) -> None:
    """The band holds what is drawn as a curve each, whichever way round a flight turned."""
    others = [write_run(tmp_path / f"{laps}.mcap", Run(laps=laps, step_us=100_000)) for laps in (1, 2)]
    code, out = call("plot", run_log, bad_log, *others, "--band", "--paper", "ieee", "--out", tmp_path / "band")
    assert code == 0 and [Path(line).stem for line in out.splitlines()[::2]] == list(BANDS)
    code, out = call("plot", run_log, bad_log, "--band", "--out", tmp_path / "few")
    assert code == 1 and "3 logs or more, not 2" in out and not (tmp_path / "few").exists()


def flight_of(reached_s: Sequence[float | None], end_s: float = 10.0) -> Any:
    """A flight that was at the waypoints of its tour at these times."""
    track = SimpleNamespace(t_s=np.linspace(0.0, end_s, 401))
    tour = [SimpleNamespace(t_s=at_s) for at_s in reached_s]
    return SimpleNamespace(track=track, tour=tour, flight=SimpleNamespace(armed=Span(0.0, end_s)))


def band_of(scenes: Sequence[Any], curves: Sequence[FloatArray], panel: int) -> tuple[FloatArray, FloatArray]:
    """The line in the middle, and the heights of the band's outline."""
    ax = Figure().subplots()
    figure_tracks._draw_band(ax, figure_tracks.PANELS["2_depth_and_yaw"][panel], scenes, curves)
    (band,) = ax.collections
    return np.asarray(ax.lines[0].get_ydata()), np.asarray(band.get_paths()[0].vertices)[:, 1]


def test_a_band_takes_headings_of_either_turn_as_the_same() -> None:
    heading = np.linspace(0.0, 6.0, 401)
    middle, outline = band_of([flight_of(())] * 4, [heading + 2.0 * np.pi * turns for turns in (-1, 0, 0, 1)], 1)
    assert np.ptp(middle) == pytest.approx(6.0, abs=0.1) and np.ptp(outline) == pytest.approx(6.0, abs=0.1)


def test_half_of_the_flights_turn_to_the_other_side_and_the_middle_is_one_of_them() -> None:
    turn = np.linspace(0.0, np.pi, 401)
    middle, _ = band_of([flight_of(())] * 4, [turn, turn, -turn, -turn], 1)
    assert np.abs(np.diff(middle)).max() < 0.1 and abs(abs(middle[-1]) - np.pi) < 0.1


@given(
    legs_s=st.lists(st.lists(st.floats(2.0, 30.0), min_size=4, max_size=4), min_size=3, max_size=7),
    given_up=st.integers(0, 4),
)
def test_flights_of_the_same_way_have_no_spread_however_long_each_of_their_legs_took(
    legs_s: list[list[float]], given_up: int
) -> None:
    """Depth is a metre a leg; the first flight ends at a waypoint, where it stays."""
    scenes, curves = [], []
    for number, legs in enumerate(legs_s):
        reached_s = np.cumsum(legs)
        count = given_up if number == 0 and len(legs_s) > 2 else len(legs)
        scene = flight_of([*reached_s[:count].tolist(), *[None] * (len(legs) - count)], float(reached_s[-1]))
        scenes.append(scene)
        curves.append(np.interp(scene.track.t_s, np.append(0.0, reached_s[:count]), np.arange(count + 1.0)))
    abreast = figure_tracks.Abreast(scenes)
    for curve, one in zip(abreast.sampled(curves), (given_up, *[4] * (len(scenes) - 1)), strict=True):
        np.testing.assert_allclose(curve, np.minimum(abreast.sampled([curves[-1]] * len(scenes))[-1], one), atol=0.15)


class Loads(HTMLParser):
    """Everything that a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            inside = value is None or value.startswith(("data:", "#"))
            if name in ("src", "href", "srcset", "data", "action", "poster") and value and not inside:
                self.found.append(f"{tag} {value}")

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def test_report_is_one_file_that_loads_nothing(report: Path) -> None:
    page = report.read_text(encoding="utf-8")
    loads = Loads()
    loads.feed(page)
    assert loads.found == []
    styles = "".join(re.findall(r"<style>(.*?)</style>", page, re.S))
    assert "url(" not in styles and "@import" not in styles
    assert report.stat().st_size < 6_000_000
    text = "".join(loads.text)
    for expected in ("paper-tank", "planar speed", "waypoint B heading", "lap 0", "1234.5", "/nav/state", "mission"):
        assert expected in text
    assert page.count("data-root-id") >= 16


def test_report_of_poor_logs(tmp_path: Path) -> None:
    """A cut-off log without truth, whose operator has written what a page must not run."""
    nasty = replace(ONE_LAP, scenario="<script>alert(1)</script>", obstacles=())
    poor = write_run(tmp_path / "poor.mcap", Run(laps=1, step_us=500_000, with_truth=False, description=nasty))
    data = poor.read_bytes()
    poor.write_bytes(data[: len(data) // 2])
    page = write_report(open_log(poor), tmp_path / "poor.html").read_text(encoding="utf-8")
    assert "cut off" in page
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page
    with pytest.raises(LogError, match="neither"):
        write_report(open_log(bare(tmp_path / "bare.mcap")), tmp_path / "bare.html")
    with pytest.raises(LogError, match="cannot be written"):
        write_report(open_log(poor), tmp_path)


@given(st.integers(1, 5000), st.integers(1, 50), st.data())
@settings(deadline=None, max_examples=50)
def test_decimation_keeps_every_extreme(count: int, buckets: int, data: st.DataObject) -> None:
    values = np.random.default_rng(count).normal(size=count)
    spike = data.draw(st.integers(0, count - 1))
    values[spike] = 1e3
    t_s, kept = decimate(np.arange(count) * 0.01, values, buckets)
    assert len(kept) <= max(2 * buckets + 2, 2) and len(t_s) == len(kept)
    assert kept.max() == 1e3 and kept.min() == values.min()
    assert (np.diff(t_s) > 0).all() and kept[0] == values[0] and kept[-1] == values[-1]


def test_info(run_log: Path, tmp_path: Path) -> None:
    code, out = call("info", run_log)
    assert code == 0 and "/nav/state" in out and "paper-tank" in out
    code, out = call("info", run_log, "--json")
    facts = json.loads(out)
    assert code == 0 and facts["topics"]["/sim/truth"] == {
        "type": "autopilot_msgs/VehicleState",
        "messages": 366,
        "rate_hz": pytest.approx(10.0, rel=0.05),
    }
    data = run_log.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    code, out = call("info", cut)
    assert code == 3 and "cut off" in out and "messages are readable" in out
    code, out = call("info", cut, "--json")
    assert code == 3 and json.loads(out)["problems"]


def test_unreadable_logs_give_one_line(tmp_path: Path) -> None:
    junk, empty, none = (tmp_path / f"{name}.mcap" for name in ("junk", "empty", "none"))
    junk.write_bytes(b"not a log at all" * 64)
    empty.write_bytes(b"")
    for command in ("info", "check", "report", "plot"):
        for path in (junk, empty, none):
            code, out = call(command, path)
            assert code == 1 and out.startswith("error: ") and out.count("\n") == 1 and str(path) in out
            assert path is not none or "check the name" in out
    assert sorted(tmp_path.iterdir()) == [empty, junk], "nothing is left"


def test_check(run_log: Path, bad_log: Path, tmp_path: Path) -> None:
    code, out = call("check", run_log)
    assert code == 0 and "verdict: pass" in out
    code, out = call("check", bad_log)
    assert code == 1 and "verdict: fail" in out
    code, out = call("check", bad_log, "--json")
    listed = json.loads(out)
    assert code == 1 and listed["verdict"] == "fail"
    assert [row["name"] for row in listed["rows"] if row["verdict"] == "fail"] == ["planar speed"]
    data = run_log.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) - 10])
    code, out = call("check", cut)
    assert code == 3 and "log damage" in out


@pytest.mark.parametrize("everything", [(), ("--all",)], ids=["short", "all"])
@pytest.mark.parametrize("columns", [80, 140])
def test_the_verdict_and_what_broke_come_first_and_nothing_is_cut(
    bad_log: Path, monkeypatch: pytest.MonkeyPatch, columns: int, everything: tuple[str, ...]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    _, out = call("check", bad_log, *everything)
    lines = out.splitlines()
    rows = [row for row in acceptance_table(open_log(bad_log)) if everything or row in short_form_of(bad_log)]
    assert max(map(len, lines)) <= columns and "…" not in out
    assert next(line for line in lines if "verdict" in line).startswith("verdict: fail (")
    for row in rows:
        for word in f"{row.name} {row.note} {format_figure(row.worst)} {format_figure(row.limit)} {row.unit}".split():
            assert word in out, row
    if not everything:
        below = lines[lines.index(next(line for line in lines if "───" in line)) + 1]
        assert below.split()[:2] == ["planar", "speed"] and " fail" in below
        assert len(rows) == 12 and "more rows: autopilot log check LOG --all" in out


def short_form_of(path: Path) -> list[BoundRow]:
    return short_form(acceptance_table(open_log(path)))


def test_a_log_has_to_be_named() -> None:
    assert call("report")[0] == call("plot")[0] == 2


def test_group_lists_its_commands_without_heavy_imports() -> None:
    looks = {"info", "check", "compare", "report", "plot", "replay", "programs", "tlog", "view"}
    assert set(log_command.commands) == looks | {"export", "diff", "find", "recover"}
    heavy = "{'numpy', 'mcap', 'matplotlib', 'bokeh', 'rich'}"
    code = f"import sys, autopilot.cli.log; sys.exit(','.join({heavy} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_results_want_a_folder_where_a_file_is(run_log: Path, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    for command in ("plot", "export"):
        code, out = call(command, run_log, "--out", taken)
        assert code == 1 and str(taken) in out and "is not a folder" in out
    code, out = call("report", run_log, "--out", taken / "a.html")
    assert code == 1 and str(taken) in out and "is not a folder" in out
    assert taken.read_text() == "mine"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_a_report_on_a_full_device_is_an_error(run_log: Path) -> None:
    code, out = call("report", run_log, "--out", "/dev/full")
    assert code == 1 and "/dev/full" in out and "No space left" in out


def test_topics_that_cannot_be_decoded_are_left_out_of_an_export_and_named(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "another program")
        json_schema = writer.register_schema("some.Thing", "jsonschema", b"{}")
        twist = b"geometry_msgs/Vector3 linear\n====\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
        twist_schema = writer.register_schema("geometry_msgs/msg/Twist", "ros2msg", twist)
        channels = [
            (writer.register_channel("/nav/state", "json", json_schema), b'{"a": 1}'),
            (writer.register_channel("/cmd_vel", "cdr", twist_schema), b"\0\1\0\0" + bytes(24)),
            (writer.register_channel("/short", "cdr", twist_schema), b"\0\1\0\0" + bytes(3)),
        ]
        for channel, data in channels:
            writer.add_message(channel, 10**9, data, 10**9, 0)
        writer.finish()
    code, out = call("export", path, "--out", tmp_path / "csv")
    assert code == 3 and "/nav/state is left out" in out and "/short is left out" in out
    assert [file.name for file in (tmp_path / "csv").iterdir()] == ["cmd_vel.csv"]
    code, out = call("export", path, "--topic", "/short", "--out", tmp_path / "csv")
    assert code == 1 and str(path) in out and "/short" in out
    code, out = call("check", path)
    assert code == 1 and "/nav/state is not CDR" in out
