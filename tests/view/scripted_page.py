"""The page's own code in a browser, on events and clocks of a test's choice; one browser for all such tests."""

import atexit
import contextlib
import json
from functools import cache
from pathlib import Path
from typing import Any

from browser_module import browser

from autopilot.view.http_server import ViewServer

SCRIPT = Path(__file__).with_name("scripted_page.js").read_text(encoding="utf-8")


@cache
def _opened() -> tuple[Any, str]:
    """A tab, and the address of a page that nobody flies."""
    stack = contextlib.ExitStack()
    atexit.register(stack.close)
    server = ViewServer(0)
    stack.callback(server.close)
    return stack.enter_context(browser.page(browser.found())), server.url


def _loaded(script: str, dark: bool = False, calm: bool = False) -> Any:
    """The page, whose own code comes after the script."""
    tab, url = _opened()
    tab.size(1440, 900)
    features = {"color-scheme": "dark" if dark else "light", "reduced-motion": "reduce" if calm else "no-preference"}
    given = [{"name": f"prefers-{name}", "value": value} for name, value in features.items()]
    tab.call("Emulation.setEmulatedMedia", features=given)
    made = tab.call("Page.addScriptToEvaluateOnNewDocument", source=f"{script}; window.unseen = true")
    tab.ask("window.unseen = false")  # of the page before
    tab.open(url)
    tab.wait("window.unseen && document.readyState === 'complete'")
    tab.call("Page.removeScriptToEvaluateOnNewDocument", identifier=made["identifier"])
    return tab


def page(
    heard: list[dict[str, Any]], width: int = 700, height: int = 600, theme: str = "light", *options: str
) -> dict[str, Any]:
    """What the page makes of lines as scripted_page.js has them. ``options``: "calm" = less motion."""
    script = SCRIPT.replace("@SIZE@", json.dumps([width, height]))
    tab = _loaded(script, theme == "dark", "calm" in options)
    made: dict[str, Any] = tab.ask(f"window.play({json.dumps(heard)})")
    assert made["errors"] == [] and tab.errors == []
    return made


def module(name: str, code: str) -> Any:
    """What the code pushes onto ``made``, with all of a module of the page in a variable of its name."""
    tab, url = _opened()
    if tab.ask("location.origin") != url.rstrip("/"):
        _loaded("")
    return tab.ask(f"(async () => {{ const {name} = await import('/{name}.js'), made = []; {code}; return made; }})()")
