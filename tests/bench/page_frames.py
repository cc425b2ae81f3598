"""Frame times of the live view with ten minutes of history: ``python -m tests.bench.page_frames``.

A flight's own frames are given to the page over and over with later times until its history is full; then the time
between two animation frames is measured in headless Chromium, live and while the slider is dragged to and fro; and that
of an empty page, which is what the machine gives.
"""

import statistics
import tempfile
from pathlib import Path
from typing import Any

from tests.browser_module import browser
from tests.view.viewers import run

HISTORY_S, RATE_HZ, MEASURED_S = 600, 10, 10
FILLED = f"""(() => {{
    const Stream = window.EventSource, frames = {HISTORY_S * RATE_HZ};
    window.filled = false;
    window.EventSource = class extends Stream {{
        addEventListener(name, work) {{
            super.addEventListener(name, (event) => {{
                if (name !== "frame") return work(event);
                const frame = JSON.parse(event.data);
                const later = (k) => ({{ data: JSON.stringify({{ ...frame, t_s: frame.t_s + k }}) }});
                if (!window.filled && frame.control) {{
                    for (let k = 0; k < frames; k += 1) work(later(k / {RATE_HZ}));
                    window.filled = true;
                }}
                return work(later(window.filled ? {HISTORY_S} : 0));
            }});
        }}
    }};
}})()"""
MEASURED = f"""new Promise((done) => {{
    const times = [], slider = document.getElementById("when"), begin = performance.now();
    const step = (now) => {{
        times.push(now);
        if (%s) {{
            const share = 0.5 + 0.45 * Math.sin((now - begin) / 700);
            slider.value = String(Number(slider.min) + share * (slider.max - slider.min));
            slider.dispatchEvent(new Event("input"));
        }}
        if (now - begin < {1000 * MEASURED_S}) requestAnimationFrame(step);
        else done(times.slice(1).map((time, index) => time - times[index]));
    }};
    requestAnimationFrame(step);
}})"""


def row(page: Any, name: str, drag: str) -> str:
    """Frame rate, times between frames, and the CPU time of the page's thread in all for each frame."""
    begin_s = cpu_s(page)
    between_ms = page.ask(MEASURED % drag)
    work_ms = 1e3 * (cpu_s(page) - begin_s) / len(between_ms)
    ordered = sorted(between_ms)
    p50, p95, p99 = (ordered[int(share * (len(ordered) - 1))] for share in (0.5, 0.95, 0.99))
    return (
        f"{name:24} {1e3 / statistics.mean(ordered):6.1f} {p50:6.1f} {p95:6.1f} {p99:6.1f} {ordered[-1]:6.1f}"
        f" {work_ms:6.1f}"
    )


def cpu_s(page: Any) -> float:
    metrics = page.call("Performance.getMetrics")["metrics"]
    return float(next(one["value"] for one in metrics if one["name"] == "TaskDuration"))


def main() -> None:
    program = browser.found()
    if program is None:
        raise SystemExit("no Chromium here; CHROMIUM names one")
    print(f"{'':24} {'1/s':>6} {'p50':>6} {'p95':>6} {'p99':>6} {'max':>6} {'CPU':>6}  [ms]")
    flight = ("paper-tank", "--start", "--sensors", "pose")
    with tempfile.TemporaryDirectory() as folder, run(Path(folder), *flight) as made:
        for span in ("60", "600"):
            with browser.page(program) as page:
                measured(page, made.port, span)


def measured(page: Any, port: int, span: str) -> None:
    page.size(1440, 900)
    page.call("Performance.enable", timeDomain="threadTicks")
    print(row(page, "an empty page", "false"))
    page.call("Page.addScriptToEvaluateOnNewDocument", source=FILLED)
    page.open(f"http://127.0.0.1:{port}/")
    page.wait("window.filled")
    page.ask(f"document.getElementById('span').value = '{span}'")
    kept = page.ask("document.getElementById('when').max - document.getElementById('when').min")
    heap = page.call("Runtime.getHeapUsage")["usedSize"]
    print(f"charts of {span} s; history of {kept:.0f} s, heap of {1e-6 * heap:.0f} MB")
    print(row(page, "live", "false"))
    print(row(page, "the slider is dragged", "true"))
    if page.errors:
        raise SystemExit("\n".join(page.errors))


if __name__ == "__main__":
    main()
