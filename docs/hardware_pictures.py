"""Takes the pictures of docs/hardware.md: ``python docs/hardware_pictures.py [STEP ...]`` (default: all).

Walks the page on an emulated BlueROV2, by the commands that it gives: the floor to print, the doctor, a hover by depth
alone, one by markers, a mission. Each writes docs/figures/hardware_STEP.png. Needs a Chromium (docs/browser.py) and, as
the flights are in real time, an idle machine: a picture with a failsafe in it is not taken.
"""

import contextlib
import html
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import browser
from PIL import Image
from pymavlink.dialects.v20 import development as mav

from autopilot.client.client_session import CommandRefusedError, VehicleConnection
from autopilot.run.children import autopilot_command, free_port

FIGURES = Path(__file__).resolve().parent / "figures"
SCREEN = 1180, 760
"""Pixels of the view's pictures."""
SHEET = 640, 400
"""The same of a corner of a sheet."""
SHEET_WIDTH = 1500
"""Pixels of a whole sheet then."""
COLORS = 96
"""Of a picture's palette: its size in bytes falls to a third."""
PATIENCE_S = 300.0
"""Against a hang only."""
SHOWN_S = 10.0
"""So long the view is open before its picture is taken."""
QUIET_S = 120.0
"""So long a failsafe is given to be over."""
ALTITUDE_MODE = 2
"""PX4's main mode under which the autopilot holds the depth."""
PLAN = "tank.plan"
PILLARS = ("--obstacle", "-0.625,-0.625,0.16", "--obstacle", "0.9375,0,0.16")
"""The cylinders of the paper's tank."""


class Walk:
    """A folder with a new owner's files, an emulated vehicle, and the autopilot on it."""

    def __init__(self, folder: Path, *, markers: bool, tracked: bool) -> None:
        self._folder = folder
        self._environment = os.environ | {"AUTOPILOT_STATE_DIR": str(folder), "AUTOPILOT_LOG_DIR": str(folder)}
        self._processes: list[subprocess.Popen[bytes]] = []
        below, self.ours = free_port(), free_port()
        camera = ("--camera", f"127.0.0.1:{free_port()}") if markers else ()
        pose = f"udpout:127.0.0.1:{self.ours}" if tracked else "off"
        self.do("config", "new", "rov")
        self.do(*("mission", "new", "--tank", "5x3", "--vehicle", "bluerov2"), *PILLARS, "--out", PLAN)
        if markers:
            self.do("scenario", "markers", "paper-tank", "--out", "floor.toml")
        emulated = self.begin(
            *("emulate", "paper-tank", "--link", f"udpout:127.0.0.1:{below}", "--pose", pose, *camera)
        )
        config = (folder / "rov.toml").read_text(encoding="utf-8").replace("0.0.0.0:14555", f"127.0.0.1:{below}")
        config = re.sub(r"^connect = \[.*\]", f'connect = ["udpin:127.0.0.1:{self.ours}"]', config, flags=re.MULTILINE)
        if markers:
            printed = self.printed(emulated, r"(\[devices\.camera\]\n(?:.+\n){3})")
            config = config.replace("[place]\n", '[place]\nmarkers = "floor.toml"\n')
            config += "\n" + printed
        (folder / "rov.toml").write_text(config, encoding="utf-8")

    def do(self, *arguments: str) -> str:
        """What a command prints. Warnings (exit code 3) and the doctor's verdict are no failure."""
        done = subprocess.run(
            autopilot_command(*arguments),
            cwd=self._folder,
            env=self._environment | {"COLUMNS": "118"},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode not in (0, 1, 3) or (done.returncode == 1 and arguments[0] != "doctor"):
            raise SystemExit(done.stderr)
        return done.stdout

    def begin(self, *arguments: str) -> Path:
        """Start a command; the file of what it prints."""
        out = self._folder / f"{arguments[0]}.txt"
        with out.open("wb") as file:
            process = subprocess.Popen(
                autopilot_command(*arguments),
                cwd=self._folder,
                env=self._environment,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        self._processes.append(process)
        return out

    def printed(self, out: Path, pattern: str) -> str:
        begin_s = time.monotonic()
        while (found := re.search(pattern, out.read_text(encoding="utf-8"))) is None:
            if time.monotonic() - begin_s > PATIENCE_S:
                raise SystemExit(f"not printed: {pattern}\n{out.read_text(encoding='utf-8')}")
            time.sleep(0.1)
        return found[1]

    def run(self, *arguments: str) -> str:
        """Start the autopilot; where its view is."""
        return self.printed(self.begin("run", "--config", "rov.toml", *arguments, "--view", "0"), r"view: (\S+)")

    def end(self) -> None:
        for process in reversed(self._processes):
            process.terminate()
            process.wait()


@contextlib.contextmanager
def walk(*, markers: bool = False, tracked: bool = False) -> Iterator[Walk]:
    with tempfile.TemporaryDirectory() as folder:
        made = Walk(Path(folder), markers=markers, tracked=tracked)
        try:
            yield made
        finally:
            made.end()


def kept(page: Any, name: str) -> None:
    """The page as a picture of few colours."""
    path = FIGURES / f"hardware_{name}.png"
    page.picture(path)
    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


def waited(vehicle: VehicleConnection, seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        vehicle.poll(0.1)


def sticks(vehicle: VehicleConnection, seconds: float, up: int = 500) -> None:
    """A pilot's, at rest but for the vertical one: 0 to 1000."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        vehicle.send(mav.MAVLink_manual_control_message(1, 0, 0, up, 0, 0))
        vehicle.poll(0.1)


def flown(
    name: str,
    made: Walk,
    fly: Callable[[VehicleConnection], None],
    rest: Callable[[VehicleConnection, float], None] = waited,
) -> None:
    """The view of a flight once ``fly`` has returned; until it shows no failsafe ``rest`` goes on."""
    url = made.run("--plan", PLAN)
    with browser.page(browser.found()) as page, VehicleConnection(f"udpout:127.0.0.1:{made.ours}") as vehicle:
        vehicle.connect(PATIENCE_S)
        fly(vehicle)
        page.size(*SCREEN)
        page.open(url)
        rest(vehicle, SHOWN_S)
        begin_s = time.monotonic()
        while alarms := page.ask("document.getElementById('alarms').textContent"):
            if time.monotonic() - begin_s > QUIET_S:
                raise SystemExit(f"{name}: no picture, {alarms}; end other programs and try again")
            rest(vehicle, 0.3)
        if page.errors:
            raise SystemExit("\n".join(page.errors))
        kept(page, name)


def depth() -> None:
    """A hover by depth alone."""

    def fly(vehicle: VehicleConnection) -> None:
        sticks(vehicle, 1.0)
        vehicle.command(mav.MAV_CMD_DO_SET_MODE, 1.0, float(ALTITUDE_MODE), 0.0)
        armed(vehicle)
        sticks(vehicle, 1.0)
        sticks(vehicle, 3.0, up=300)
        sticks(vehicle, 1.0)

    with walk() as made:
        flown("depth", made, fly, sticks)


def markers() -> None:
    """A hover by markers."""
    with walk(markers=True) as made:
        flown("markers", made, armed)


def mission() -> None:
    """The mission under way, by a tracking system."""

    def fly(vehicle: VehicleConnection) -> None:
        armed(vehicle)
        vehicle.start_mission()

    with walk(tracked=True) as made:
        flown("mission", made, fly)


def armed(vehicle: VehicleConnection) -> None:
    """Arm once the vehicle is ready: it reads the flight controller's parameters first."""
    begin_s = time.monotonic()
    while True:
        try:
            vehicle.arm()
            return
        except CommandRefusedError as error:
            if time.monotonic() - begin_s > PATIENCE_S:
                raise SystemExit(f"cannot arm: {error}") from error
        waited(vehicle, 1.0)


def doctor() -> None:
    """What the doctor prints."""
    with walk(tracked=True) as made, browser.page(browser.found()) as page:
        text = made.do("doctor", "--config", "rov.toml", "--plan", PLAN)
        lines = [line.rstrip() for line in text.splitlines()]
        rows = html.escape("\n".join(lines))
        for word, color in (("ok", "#7ee08a"), ("warn", "#f0c23c"), ("fail", "#ff7b72")):
            rows = rows.replace(f"│ {word} ", f'│ <b style="color:{color}">{word}</b> ')
        style = "margin:0;padding:10px;background:#15191d;color:#dfe5ea;font:13px/1.25 monospace;width:max-content"
        file = Path(made._folder) / "doctor.html"
        file.write_text(f'<meta charset="utf-8"><body style="margin:0"><pre style="{style}">{rows}</pre>')
        page.size(1000, 300)
        page.open(file.as_uri())
        page.wait("document.readyState === 'complete'")
        page.size(*page.ask("[document.querySelector('pre').offsetWidth, document.querySelector('pre').offsetHeight]"))
        kept(page, "doctor")


def floor() -> None:
    """The first sheet of the floor to print: its corner with the scale bar."""
    with tempfile.TemporaryDirectory() as text, browser.page(browser.found()) as page:
        folder = Path(text)
        command = autopilot_command(
            *("markers", "board", "--floor", "5", "3", "--paper", "A0", "--out", str(folder / "board"))
        )
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        page.size(*SHEET)
        image = f'<img src="board/sheet-001.svg" width="{SHEET_WIDTH}">'
        (folder / "sheet.html").write_text(f'<body style="margin:0;overflow:hidden">{image}')
        page.open((folder / "sheet.html").as_uri())
        page.wait("document.images[0]?.complete && document.images[0].naturalWidth > 0")
        page.ask("window.scrollTo(0, 1e6)")
        kept(page, "floor")


STEPS = {step.__name__: step for step in (floor, doctor, depth, markers, mission)}


if __name__ == "__main__":
    for chosen in sys.argv[1:] or STEPS:
        STEPS[chosen]()
