"""``autopilot log view``: a log in the page of the live view, by its process and in a browser."""

import json
import math
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from browser_module import browser, needs_browser, pixels_of
from click.testing import CliRunner
from scripted_page import module
from viewers import Page, Stream, get, post, press, run

from autopilot.cli.log import log as log_command
from autopilot.log.reader import open_log
from autopilot.run.children import autopilot_command, free_port
from autopilot.view.page_state import FlowView, LogFramesView, LogView, PictureView
from tests.log.log_synthetic import Run, write_run

ARROW, SPACE, HOME, END, NEXT = ("ArrowRight", 39), (" ", 32), ("Home", 36), ("End", 35), ("n", 78)


class Player(Page):
    """``autopilot log view LOG``."""

    def __init__(self, log: Path, folder: Path) -> None:
        super().__init__(folder, "log", "view", str(log), "--port", "0", address=r"127\.0\.0\.1")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of ten seconds with pictures."""
    folder = tmp_path_factory.mktemp("flown")
    log = folder / "run.mcap"
    arguments = ("paper-tank", "--start", "--speed", "0", "--duration", "10", "--log", str(log))
    subprocess.run(
        autopilot_command("sitl", *arguments, "--connect", f"udpin:127.0.0.1:{free_port()}"),
        check=True,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "AUTOPILOT_STATE_DIR": str(folder)},
    )
    return log


@pytest.fixture(scope="module")
def player(flown: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Player]:
    made = Player(flown, tmp_path_factory.mktemp("player"))
    yield made
    assert made.end() == 0


def test_what_the_process_serves(flown: Path, player: Player) -> None:
    status, _, body = get(player.port, "/log")
    about = msgspec.json.decode(body, type=LogView)
    assert status == 200 and about.name == "run.mcap" and about.begin_s < 0.1 and about.end_s == pytest.approx(10.0)
    assert any(event.text == "Armed" for event in about.events) and about.scene.title == "paper-tank"
    assert not about.scene.steerable.pause and about.scene.camera_px is not None
    status, _, body = get(player.port, "/frames?from=5&to=6&step=0.25")
    answer = msgspec.json.decode(body, type=LogFramesView)
    assert status == 200 and [round(frame.t_s, 3) for frame in answer.frames] == [5.0, 5.25, 5.5, 5.75, 6.0]
    nav = open_log(flown)["/nav/state"]
    for frame in answer.frames:
        row = nav[nav["t_us"] <= round(1e6 * frame.t_s)][-1]
        assert frame.estimate is not None
        assert frame.estimate.pos_ned_m == pytest.approx(row["pos_ned_m"].tolist(), abs=1e-4)
    picture = msgspec.json.decode(get(player.port, "/picture?t=6")[2], type=PictureView)
    assert 5 < picture.t_s <= 6 and picture.width_px == about.scene.camera_px[0] and len(picture.markers) > 2


@pytest.mark.parametrize(
    ("path", "named"),
    [
        ("/frames?from=1&to=x&step=1", "to='x'"),
        ("/frames?from=1&to=2", "step=''"),
        ("/frames?from=nan&to=2&step=1", "from='nan'"),
        ("/frames?from=3&to=2&step=1", "'to': 2.0"),
        ("/frames?from=1&to=9&step=0.0001", "200 frames"),
        ("/picture?t=inf", "t='inf'"),
    ],
)
def test_what_is_no_time_is_refused_by_name(player: Player, path: str, named: str) -> None:
    status, _, body = get(player.port, path)
    assert status == 400 and named in json.loads(body)["error"]


def test_a_log_is_read_only_and_has_no_stream(player: Player) -> None:
    assert get(player.port, "/events")[0] == 404
    assert post(player.port, {"do": "pause"}) == (409, {"error": "no run is under way; wait until the next has begun"})
    assert get(player.port, "/log", {"Host": "evil.example"})[0] == 403


def test_files_that_are_no_log(tmp_path: Path) -> None:
    missing = CliRunner().invoke(log_command, ["view", str(tmp_path / "none.mcap")])
    assert "none.mcap: cannot be read" in str(missing.exception)
    other = tmp_path / "text.mcap"
    other.write_text("hello there")
    assert "is not an MCAP log" in str(CliRunner().invoke(log_command, ["view", str(other)]).exception)


def test_a_log_that_was_cut_off_is_played_as_far_as_it_goes(flown: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    data = flown.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    made = Player(cut, tmp_path)
    about = msgspec.json.decode(get(made.port, "/log")[2], type=LogView)
    assert 2 < about.end_s < 9 and any("cut off" in line for line in about.scene.steerable.missing)
    assert "cut off" in made.out.read_text(encoding="utf-8")
    answer = get(made.port, f"/frames?from={about.end_s}&to={about.end_s}&step=1")
    assert msgspec.json.decode(answer[2], type=LogFramesView).frames[0].estimate is not None
    assert made.end() == 0


@pytest.fixture(scope="module")
def dragged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a flight in which an obstacle was dragged, and a current added."""
    folder = tmp_path_factory.mktemp("dragged")
    log = folder / "run.mcap"
    with run(folder, "paper-tank", "--start", "--sensors", "pose", "--log", str(log)) as made:
        stream = Stream(made.port)
        stream.until("frame", lambda frame: frame["t_s"] > 2)
        assert post(made.port, {"do": "obstacle", "number": 1, "north_m": 0.9, "east_m": -0.456})[0] == 200
        assert post(made.port, {"do": "current", "north_m_s": 0.1, "east_m_s": -0.05})[0] == 200
        begin_s = stream.until("frame", lambda frame: frame["extra_current_ned_m_s"] == [0.1, -0.05])["t_s"]
        stream.until("frame", lambda frame: frame["t_s"] > begin_s + 2)
        stream.close()
        made.end()
    return log


def test_a_log_has_what_was_dragged_and_the_field_of_the_current(dragged: Path, tmp_path: Path) -> None:
    opened = open_log(dragged)
    truth = opened["/sim/truth"]
    messages = [(one.t_us, one.value["msg"]) for one in opened.messages("/rosout")]
    changed_us = max(t_us for t_us, text in messages if text.startswith("View: "))
    made = Player(dragged, tmp_path)
    still = msgspec.json.decode(get(made.port, "/flow?t=0")[2], type=FlowView)
    places = []
    for t_us, added in ((1_000_000, 0.0), (changed_us + 1_000_000, 0.1)):
        path = f"/frames?from={1e-6 * t_us}&to={1e-6 * t_us}&step=1"
        [frame] = msgspec.json.decode(get(made.port, path)[2], type=LogFramesView).frames
        places.append(frame.solids[0].center_m)
        flow = msgspec.json.decode(get(made.port, f"/flow?t={1e-6 * t_us}")[2], type=FlowView)
        assert len(flow.arrows) > 50 and flow.t_s == pytest.approx(1e-6 * t_us)
        for arrow, before in zip(flow.arrows, still.arrows, strict=True):
            assert arrow[2] - before[2] == pytest.approx(added, abs=2e-4)
        # The nearest arrow is the current that the vehicle is in, but for how that differs from arrow to arrow.
        row = truth[truth["t_us"] <= t_us][-1]
        nearest = min(flow.arrows, key=lambda arrow: math.dist(arrow[:2], row["pos_ned_m"][:2]))
        assert nearest[2:] == pytest.approx(row["current_ned_m_s"][:2], abs=0.05)
    assert places[1] == (0.9, -0.46) != places[0]
    assert made.end() == 0


# In a browser

CLOCK = "parseFloat(document.getElementById('clock')?.textContent)"


FLOWING = f"""(() => {{
    const data = {pixels_of("plan")};
    let count = 0;
    for (let i = 0; i < data.length; i += 4) count += data[i] === 86 && data[i + 1] === 137 && data[i + 2] === 171;
    return count;
}})()"""
"""Pixels of the plan in the colour of the current."""


def opened(tab: Any, player: Player, at: str = "#t=5.5", width: int = 1440, phone: bool = False) -> None:
    tab.size(width, 900, phone=phone)
    tab.open(f"http://127.0.0.1:{player.port}/{at}")
    tab.wait("document.getElementById('state')?.children.length > 4")


@needs_browser
@pytest.mark.parametrize(("at", "t_s"), [("#t=5.5", 5.5), ("?t=7.2", 7.2), ("", 0.0), ("#t=1e9", 10.0), ("#t=x", 0.0)])
def test_the_address_says_the_time(player: Player, at: str, t_s: float) -> None:
    with browser.page(browser.found()) as tab:
        opened(tab, player, at)
        tab.wait(f"Math.abs({CLOCK} - {t_s}) < 0.06")
        if at == "#t=5.5":
            tab.ask("location.hash = '#t=8'")
            tab.wait(f"{CLOCK} === 8")
        assert tab.errors == []


@needs_browser
def test_the_page_of_a_log_shows_the_moment_whole(flown: Path, player: Player) -> None:
    with browser.page(browser.found()) as tab:
        opened(tab, player)
        tab.wait(f"{CLOCK} === 5.5")
        nav = open_log(flown)["/nav/state"]
        row = nav[nav["t_us"] <= 5_500_000][-1]
        places = tab.ask("[...document.querySelectorAll('#state dd')][1].textContent")
        assert [float(text) for text in re.findall(r"-?[\d.]+", places)] == pytest.approx(row["pos_ned_m"], abs=0.006)
        assert tab.ask("document.getElementById('past').textContent") == "Log"
        assert "Armed" in tab.ask("document.getElementById('messages').textContent")
        assert (
            tab.ask("document.getElementById('steer').hidden")
            and tab.ask("document.querySelectorAll('.stale').length") == 0
        )
        tab.wait("document.getElementById('cameraage').textContent")
        assert tab.errors == []


def set_rate(tab: Any, rate: str) -> None:
    tab.ask(f"document.getElementById('rate').value = '{rate}'")
    tab.ask("document.getElementById('rate').dispatchEvent(new Event('change'))")


@needs_browser
def test_play_pause_speed_and_keys(player: Player) -> None:
    with browser.page(browser.found()) as tab:
        opened(tab, player)
        press(tab, *ARROW)
        tab.wait(f"{CLOCK} === 5.6")
        press(tab, *ARROW, shift=True)
        tab.wait(f"{CLOCK} === 6.6")
        tab.ask("document.getElementById('when').focus()")
        press(tab, *HOME)
        tab.wait(f"{CLOCK} < 0.1")
        press(tab, *END)
        tab.wait(f"{CLOCK} === 10")
        press(tab, *HOME)
        tab.wait(f"{CLOCK} < 0.1")
        set_rate(tab, "0.25")  # a busy machine must not come to the end
        press(tab, *SPACE)
        tab.wait("document.getElementById('play').textContent === 'Pause'")
        tab.wait(f"{CLOCK} > 0.2")
        press(tab, *SPACE)
        tab.wait("document.getElementById('play').textContent === 'Play'")
        stopped = tab.ask(CLOCK)
        assert tab.wait("location.hash !== '#t=5.5' && location.hash") is not None
        press(tab, *ARROW)
        tab.wait(f"{CLOCK} > {stopped}")
        set_rate(tab, "4")
        press(tab, *SPACE)
        tab.wait("document.getElementById('play').textContent === 'Play'")  # at the end
        tab.wait(f"{CLOCK} === 10")
        assert tab.errors == []


@needs_browser
def test_from_message_to_message(player: Player) -> None:
    about = msgspec.json.decode(get(player.port, "/log")[2], type=LogView)
    times = sorted({event.t_s for event in about.events if event.severity != "DEBUG"})
    with browser.page(browser.found()) as tab:
        opened(tab, player, "#t=0")
        tab.ask("document.getElementById('next').click()")
        first = next(t_s for t_s in times if t_s > 0.05)
        tab.wait(f"Math.abs({CLOCK} - {first}) < 0.06")
        tab.ask(
            f"const list = document.getElementById('events'); list.value = '{times[-1]}';"
            "list.dispatchEvent(new Event('change'))"
        )
        tab.wait(f"Math.abs({CLOCK} - {times[-1]}) < 0.06")
        tab.ask("document.getElementById('prior').click()")
        tab.wait(f"{CLOCK} < {times[-1]} - 0.02")
        tab.ask("document.activeElement.blur()")
        press(tab, *NEXT)
        tab.wait(f"Math.abs({CLOCK} - {times[-1]}) < 0.06")
        assert tab.errors == []


@needs_browser
def test_dragging_in_the_charts_goes_through_the_log(player: Player) -> None:
    box = "document.getElementById('strips').getBoundingClientRect()"
    with browser.page(browser.found()) as tab:
        opened(tab, player)
        x, y, width, height = tab.ask(f"[{box}.x, {box}.y, {box}.width, {box}.height]")
        for kind, share in (("mousePressed", 0.5), ("mouseMoved", 0.75), ("mouseReleased", 0.75)):
            px = x + (34 + share * (width / 6 - 42))
            tab.call(
                "Input.dispatchMouseEvent", type=kind, x=px, y=y + height / 2, button="left", buttons=1, clickCount=1
            )
        tab.wait(f"Math.abs({CLOCK} - 7.5) < 0.2")
        assert tab.errors == []


@needs_browser
@pytest.mark.parametrize("width", [390, 768, 1440])
def test_nothing_sticks_out_and_everything_has_a_name(player: Player, width: int) -> None:
    with browser.page(browser.found()) as tab:
        opened(tab, player, width=width, phone=width < 500)
        assert tab.ask("document.documentElement.scrollWidth") <= width
        for name in ("play", "when"):
            lower_px = tab.ask(f"document.getElementById('{name}').getBoundingClientRect().bottom")
            assert lower_px < tab.ask("innerHeight"), name
        unnamed = """[...document.querySelectorAll("#timeline button, #timeline select, #timeline input")]
            .filter((one) => one.checkVisibility() && !one.ariaLabel && !one.textContent.trim())
            .filter((one) => !one.labels || !one.labels.length)"""
        assert tab.ask(f"{unnamed}.length") == 0
        assert tab.ask("document.getElementById('when').ariaValueText") == "5.5 of 10.0 s"
        assert tab.errors == []


@needs_browser
@pytest.mark.parametrize("dark", [False, True])
def test_a_log_without_truth_and_pictures(tmp_path: Path, dark: bool) -> None:
    """As of a vehicle: no position error, no camera; and charts that are asked for round the time shown."""
    log = write_run(tmp_path / "tank.mcap", Run(laps=3, step_us=500_000, with_truth=False))
    made = Player(log, tmp_path)
    with browser.page(browser.found()) as tab:
        tab.size(1440, 900, dark=dark)
        tab.open(f"http://127.0.0.1:{made.port}/#t=20")
        tab.wait(f"{CLOCK} === 20")
        assert "Position error" not in tab.ask("document.getElementById('state').textContent")
        tab.ask("document.getElementById('span').value = '60'")
        tab.ask("document.getElementById('span').dispatchEvent(new Event('change'))")
        press(tab, *ARROW, shift=True)
        tab.wait(f"{CLOCK} === 21")
        tab.ask("location.hash = '#t=100'")
        tab.wait(f"{CLOCK} === 100")
        assert tab.errors == []
    assert made.end() == 0


@needs_browser
def test_ten_minutes_are_kept_and_no_more() -> None:
    """At ten frames a second; each moment is that frame with its messages; a run that begins anew has no past."""
    kept, count, frames, span, t_s, text, points, north, heading, speed, first, after, begin = module(
        "history",
        """const { History, KEPT } = history, all = new History(), scene = { name: 1 };
        const frame = (k) => ({ scene: 1, t_s: k / 10, truth: null, control: null, thrust_n: [k, -k],
            messages: k % 100 ? [] : [{ number: k / 100 + 1, t_s: k / 10, text: `at ${k}` }],
            estimate: { health: "GOOD", pos_ned_m: [k / 100, 0, 1], rpy_rad: [0, 0, -1],
                vel_water_frd_m_s: [3, 4, 0], sigma_pos_m: [0, 0, 0] } });
        for (let k = 0; k < 20000; k += 1) all.add(frame(k), scene);
        const { frame: old, trail } = all.moment(1950.04);
        made.push(KEPT, all.count, all.frames.length, all.end - all.begin);
        made.push(old.t_s, old.messages.at(-1).text, trail.length, trail.at(-1)[0]);
        made.push(all.columns.heading[0], all.columns.speed[0], all.moment(0).frame.t_s === all.begin);
        all.add(frame(3), scene);
        made.push(all.count, all.begin);""",
    )
    assert kept <= count == frames <= 1.25 * kept and 600 - 0.2 <= span <= 750
    assert (
        (t_s, text, after, begin) == (1950, "at 19500", 1, 0.3)
        and points == 1500
        and north == pytest.approx(195, abs=0.02)
    )
    assert heading == pytest.approx(302.7, abs=0.1) and speed == 5 and first


@needs_browser
def test_the_plan_of_a_log_shows_the_current(dragged: Path, tmp_path: Path) -> None:
    made = Player(dragged, tmp_path)
    with browser.page(browser.found()) as tab:
        opened(tab, made, "#t=3")
        tab.wait(f"{FLOWING} > 200")
        assert tab.errors == []
    assert made.end() == 0
