"""Takes the pictures of README and docs: ``python docs/pictures.py`` flies the paper's mission in real time for half a
minute, photographs the live view as a desk and a phone show it, the report of that log, and what the camera saw.

Writes docs/figures/view_desk.png, view_phone.png, report.png (these need a Chromium: docs/browser.py) and camera.png.
Without one docs/view_picture.py draws the view by the page's own code in node.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import browser
import cv2
import numpy as np

from autopilot.log.reader import open_log
from autopilot.run.children import autopilot_command

FIGURES = Path(__file__).resolve().parent / "figures"
AT_S = 20.0
"""Vehicle time of the pictures of the view."""
CAMERA_S = 8.0
"""And of the camera's: under way."""
FLIGHT_S = 1200.0
"""Against a hang only: a busy machine does not keep up with real time."""
GREEN, RED = (80, 210, 60), (60, 60, 250)
SHRUNK = 0.75
"""Of the report, whose text has room."""


def flown(log: Path, *, looks: bool) -> None:
    """A flight until then, with pictures of its view."""
    command = autopilot_command(
        *("sitl", "paper-tank", "--start", "--view", "0", "--connect", "udpin:127.0.0.1:24798"),
        *("--log", str(log), "--duration", f"{AT_S + 10.0:g}"),
    )
    environment = {**os.environ, "AUTOPILOT_STATE_DIR": str(log.parent), "AUTOPILOT_LOG_DIR": str(log.parent)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert process.stdout is not None
        found = re.search(r":(\d+)/", process.stdout.readline())
        assert found is not None, "the process has not printed where its view is"
        if looks:
            photographed(int(found[1]))
        process.communicate()
    finally:
        process.kill()
        process.wait()


def photographed(port: int) -> None:
    """Desk and phone, one after the other."""
    program = browser.found()
    assert program is not None
    with browser.page(program) as page:
        page.size(1200, 830)
        page.open(f"http://127.0.0.1:{port}/")
        page.wait("document.getElementById('state')?.children.length > 4")
        page.ask("document.getElementById('camerabox').open = true")
        page.ask("document.getElementById('steer').open = false")
        page.wait(f"parseFloat(document.getElementById('clock').textContent) > {AT_S}", FLIGHT_S)
        page.picture(FIGURES / "view_desk.png")
        page.ask("document.getElementById('camerabox').open = false")
        page.size(390, 844, phone=True, dark=True)
        page.wait(f"parseFloat(document.getElementById('clock').textContent) > {AT_S + 1.0}")
        page.picture(FIGURES / "view_phone.png")
        if page.errors:
            raise SystemExit("\n".join(page.errors))


def reported(log: Path) -> None:
    """The head of the report."""
    program = browser.found()
    assert program is not None
    html = log.with_suffix(".html")
    subprocess.run(
        autopilot_command("log", "report", str(log), "--out", str(html)), check=True, stdout=subprocess.DEVNULL
    )
    with browser.page(program) as page:
        page.size(1280, 1500)
        page.open(html.as_uri())
        page.wait("document.readyState === 'complete' && document.body.scrollHeight > 600")
        page.wait("new Promise((done) => setTimeout(() => done(true), 3000))")  # bokeh draws after that
        page.picture(FIGURES / "report.png")
        if page.errors:
            raise SystemExit("\n".join(page.errors))
    image = cv2.imread(str(FIGURES / "report.png"))
    assert image is not None
    cv2.imwrite(
        str(FIGURES / "report.png"), cv2.resize(image, None, fx=SHRUNK, fy=SHRUNK, interpolation=cv2.INTER_AREA)
    )


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
        cv2.putText(image, str(number), at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, GREEN, 1, cv2.LINE_AA)
    if row["laser_found"]:
        cv2.circle(image, np.round(row["laser_px"]).astype(int).tolist(), 9, RED, 2, cv2.LINE_AA)
    cv2.imwrite(str(FIGURES / "camera.png"), image)


def main() -> None:
    """All of them."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "run.mcap"
        looks = browser.found() is not None
        flown(log, looks=looks)
        seen(log)
        if not looks:
            sys.exit("no Chromium here (CHROMIUM names one): the pictures of pages are as they were")
        reported(log)


if __name__ == "__main__":
    main()
