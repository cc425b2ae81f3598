"""Takes the pictures of README and docs: ``python docs/page_pictures.py [LOG]`` (default: the demo's log).

Flies the paper's mission for some seconds and photographs the live view as a desk and a phone show it; photographs the
report of LOG, and draws into a picture of its camera what was found there. Writes docs/figures/view_desk.png,
view_phone.png, report.png (these need a Chromium: docs/browser.py), demo_xy.png and camera.jpg.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import browser
import cv2
import numpy as np
from viewed_flight import AT_S, viewed_flight

from autopilot.log.reader import open_log
from autopilot.run.children import autopilot_command

FIGURES = Path(__file__).resolve().parent / "figures"
CAMERA_S = 8.0
"""Vehicle time of the camera's picture: under way."""
DESK = 1440, 900
"""Pixels of a screen on a desk."""
FLIGHT_S = 1200.0
"""Against a hang only: a busy machine does not keep up with real time."""
GREEN, RED, DARK = (80, 240, 60), (60, 60, 250), (40, 40, 30)
SHRUNK = 0.75
"""Of the report, whose text has room."""


def view() -> None:
    """A flight until then, with pictures of its view. In lockstep, so that a busy machine shows the same."""
    with viewed_flight(24798, "--speed", "0") as port:
        photographed(port)


def photographed(port: int) -> None:
    """Desk and phone, one after the other."""
    with browser.page(browser.found()) as page:
        page.size(*DESK)
        page.open(f"http://127.0.0.1:{port}/")
        page.wait("document.getElementById('state')?.children.length > 4")
        page.wait(f"parseFloat(document.getElementById('clock').textContent) > {AT_S}", FLIGHT_S)
        page.picture(FIGURES / "view_desk.png")
        page.size(390, 844, phone=True, dark=True)
        page.open(f"http://127.0.0.1:{port}/")
        page.wait("document.getElementById('state')?.children.length > 4")
        page.wait("new Promise((done) => setTimeout(() => done(true), 2000))")
        page.picture(FIGURES / "view_phone.png")
        if page.errors:
            raise SystemExit("\n".join(page.errors))


def reported(log: Path) -> None:
    """The head of the report."""
    with tempfile.TemporaryDirectory() as folder, browser.page(browser.found()) as page:
        html = Path(folder) / "report.html"
        command = autopilot_command("log", "report", str(log.resolve()), "--out", str(html))
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        page.size(1280, 1100)
        page.open(html.as_uri())
        page.wait("document.readyState === 'complete' && document.body.scrollHeight > 600")
        page.wait("new Promise((done) => setTimeout(() => done(true), 3000))")  # bokeh draws after that
        page.picture(FIGURES / "report.png")
        if page.errors:
            raise SystemExit("\n".join(page.errors))
    image = cv2.imread(str(FIGURES / "report.png"))
    assert image is not None
    small = cv2.resize(image, None, fx=SHRUNK, fy=SHRUNK, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(FIGURES / "report.png"), small)


def drawn(log: Path) -> None:
    """Where it went, as `log plot` draws it."""
    with tempfile.TemporaryDirectory() as folder:
        command = autopilot_command("log", "plot", str(log.resolve()), "--out", folder)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        shutil.copy(Path(folder) / "1_trajectory.png", FIGURES / "demo_xy.png")


def seen(log: Path) -> None:
    """A picture of the camera with the markers that were found in it."""
    opened = open_log(log)
    found = {int(row["t_us"]): row for row in opened["/in/markers"]}
    picture = next(
        message for message in opened.messages("/in/camera") if message.t_us >= 1e6 * CAMERA_S and message.t_us in found
    )
    row = found[picture.t_us]
    image = cv2.imdecode(np.frombuffer(bytes(picture.value["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    for number, corners in zip(row["ids"][: row["count"]], row["corners_px"].reshape(-1, 4, 2), strict=False):
        cv2.polylines(image, [np.round(corners).astype(np.int32)], True, GREEN, 2, cv2.LINE_AA)
        at = np.round(corners.mean(axis=0) - (12, -5)).astype(int).tolist()
        for color, thickness in ((DARK, 4), (GREEN, 1)):
            cv2.putText(image, str(number), at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, color, thickness, cv2.LINE_AA)
    if row["laser_found"]:
        cv2.circle(image, np.round(row["laser_px"]).astype(int).tolist(), 9, RED, 2, cv2.LINE_AA)
    cv2.imwrite(str(FIGURES / "camera.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 85])


def main(log: Path) -> None:
    if not log.exists():
        sys.exit(f"{log}: there is no such log; `autopilot demo` makes one")
    drawn(log)
    seen(log)
    if browser.found() is None:
        sys.exit("no Chromium here (CHROMIUM names one): the pictures of pages are as they were")
    reported(log)
    view()


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo/run.mcap"))
