"""Draws the live view's figure: ``python docs/view_picture.py`` flies the paper's mission in real time and lets the
page's own code draw what it is sent (``docs/view_page.mjs``; needs node, no browser). Writes
docs/figures/live_view.svg."""

import http.client
import json
import subprocess
from html import escape
from pathlib import Path
from typing import Any

from viewed_flight import AT_S, viewed_flight

HERE = Path(__file__).resolve().parent
OUT = HERE / "figures" / "live_view.svg"
WIDTH, HEIGHT, PANEL = 760, 710, 430
LINE = 17


def recorded(port: int, until_s: float) -> list[dict[str, Any]]:
    """The stream of a view until then."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    connection.request("GET", "/events?pictures=1")
    answer = connection.getresponse()
    events: list[dict[str, Any]] = []
    name, t_s = "", 0.0
    while line := answer.readline().decode():
        if line.startswith("event: "):
            name = line[7:].strip()
        elif line.startswith("data: "):
            data = json.loads(line[6:])
            events.append({"name": name, "data": data})
            t_s = data["t_s"] if name == "frame" else t_s
            if name == "picture" and t_s >= until_s:
                break
    connection.close()
    return events


def drawn(events: list[dict[str, Any]], width: int, height: int, theme: str) -> dict[str, Any]:
    """What the page makes of them."""
    text = "\n".join(json.dumps(event) for event in events)
    command = ["node", str(HERE / "view_page.mjs"), str(width), str(height), theme]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
    made: dict[str, Any] = json.loads(done.stdout)
    return made


def figure(page: dict[str, Any]) -> str:
    """Plan, side view and camera as the page has drawn them, and beside them what stands in its panels."""

    def placed(name: str, x: float, y: float) -> str:
        return page["svg"][name].replace("<svg ", f'<svg x="{x}" y="{y}" ', 1)

    x, y, parts = WIDTH + 14, 24, []

    def line(words: str, at: float, *, anchor: str = "start", weight: str = "normal") -> None:
        style = f'font-family="sans-serif" font-size="12" font-weight="{weight}" text-anchor="{anchor}"'
        parts.append(f'<text x="{at}" y="{y}" fill="#1b2733" {style}>{escape(words)}</text>')

    words = page["words"]
    line(f"{words['title']}   {words['mode']}, {words['armed']}   {words['clock']}", x, weight="bold")
    for name, value in zip(page["state"][::2], page["state"][1::2], strict=True):
        y += LINE
        line(name, x)
        line(value, x + PANEL - 28, anchor="end")
    y += 8
    for bar in page["bars"]:
        y += LINE
        name, _, value = bar["words"]
        line(name, x)
        line(value, x + PANEL - 28, anchor="end")
        left, span = (float(bar["rod"][key].rstrip("%")) / 100 for key in ("left", "width"))
        color = "#c4262e" if bar["full"] else "#1f7fb4"
        parts.append(f'<rect x="{x + 110}" y="{y - 9}" width="180" height="10" fill="#e8edf2"/>')
        parts.append(f'<rect x="{x + 110 + 180 * left}" y="{y - 9}" width="{180 * span}" height="10" fill="{color}"/>')
    parts.append(placed("camera", x, y + 12))
    across, high = WIDTH + PANEL, HEIGHT
    size = f'width="{across}" height="{high}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {across} {high}">'
    back = f'<rect {size} fill="#f6f8fa"/>'
    side_y = round(0.68 * HEIGHT)
    return "\n".join([head, back, placed("plan", 0, 0), placed("side", 0, side_y), *parts, "</svg>"]) + "\n"


if __name__ == "__main__":
    with viewed_flight(24799) as port:
        events = recorded(port, AT_S)
    page = drawn(events, WIDTH, HEIGHT, "light")
    if page["errors"]:
        raise SystemExit("\n".join(page["errors"]))
    OUT.write_text(figure(page), encoding="utf-8")
    print(OUT)
