"""A client of the live view, and a simulated run that has one."""

import contextlib
import http.client
import json
import os
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from autopilot.run.children import autopilot_command, free_port

PATIENCE_S = 300.0
"""Against a hang only."""
MOST_EVENTS = 1000
"""So many events are waited for: a minute or two."""


class Page:
    """A command that serves the page, and what it has printed."""

    def __init__(self, folder: Path, *arguments: str, address: str = r"[\d.]+") -> None:
        self.out = folder / "out.txt"
        environment = {**os.environ, "AUTOPILOT_LOG_DIR": str(folder), "AUTOPILOT_STATE_DIR": str(folder)}
        with self.out.open("w", encoding="utf-8") as out:
            self.process = subprocess.Popen(
                autopilot_command(*arguments), stdout=out, stderr=subprocess.STDOUT, env=environment
            )
        self.port = int(self.printed(rf"view: http://{address}:(\d+)/\n"))

    def printed(self, pattern: str) -> str:
        """Wait until that is printed; its first group."""
        begin_s = time.monotonic()
        while time.monotonic() - begin_s < PATIENCE_S:
            found = re.search(pattern, self.out.read_text(encoding="utf-8"))
            if found:
                return found[1] if found.groups() else found[0]
            assert self.process.poll() is None, self.out.read_text(encoding="utf-8")
            time.sleep(0.05)
        raise AssertionError(f"not printed: {pattern}\n{self.out.read_text(encoding='utf-8')}")

    def end(self) -> int:
        """SIGTERM; its exit code."""
        self.process.terminate()
        try:
            return self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()


class Run(Page):
    """``autopilot sitl --view 0``, or ``run``."""

    def __init__(self, folder: Path, *arguments: str, command: str = "sitl", view: int = 0) -> None:
        super().__init__(
            folder, command, "--view", str(view), "--connect", f"udpin:127.0.0.1:{free_port()}", *arguments
        )


@contextlib.contextmanager
def run(folder: Path, *arguments: str, command: str = "sitl", view: int = 0) -> Iterator[Run]:
    """A run that is ended afterwards. ``view``: the page's port, 0 = any."""
    made = Run(folder, *arguments, command=command, view=view)
    try:
        yield made
    finally:
        if made.process.poll() is None:
            made.process.kill()
            made.process.wait()


def press(tab: Any, key: str, code: int = 0, *, shift: bool = False) -> None:
    """A key, down and up, in a browser's page."""
    text = {"text": "\r"} if key == "Enter" else {"text": key} if len(key) == 1 else {}
    both = {"key": key, "windowsVirtualKeyCode": code, "modifiers": 8 * shift}
    tab.call("Input.dispatchKeyEvent", type="keyDown", **both, **text)
    tab.call("Input.dispatchKeyEvent", type="keyUp", **both)


def get(port: int, path: str = "/", headers: dict[str, str] | None = None) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and body."""
    return _request(port, "GET", path, None, headers or {})


def post(port: int, body: object, headers: dict[str, str] | None = None, token: str | None = None) -> tuple[int, Any]:
    """What the page gets for an ask; ``token`` None = the page's own."""
    own = {
        "Content-Type": "application/json",
        "Origin": f"http://127.0.0.1:{port}",
        "X-View-Token": page_token(port) if token is None else token,
    }
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    sent = {name: value for name, value in {**own, **(headers or {})}.items() if value}
    status, _, answer = _request(port, "POST", "/do", data, sent)
    return status, json.loads(answer)


def page_token(port: int) -> str:
    """What the page knows."""
    found = re.search(rb'name="view-token" content="([^"]+)"', get(port)[2])
    assert found is not None
    return found[1].decode()


def _request(
    port: int, method: str, path: str, body: bytes | None, headers: dict[str, str]
) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    try:
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    finally:
        connection.close()


class Stream:
    """A viewer: server-sent events, parsed."""

    def __init__(self, port: int, path: str = "/events") -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        self._connection.request("GET", path)
        self.answer = self._connection.getresponse()

    def events(self) -> Iterator[tuple[str, Any]]:
        """Name and data of each event as it comes; ends with the stream."""
        name = ""
        while line := self.answer.readline():
            text = line.decode().rstrip("\n")
            if text.startswith("event: "):
                name = text[7:]
            elif text.startswith("data: "):
                yield name, json.loads(text[6:])

    def until(self, name: str, wanted: Any = lambda _: True) -> Any:
        """The next event of that name for which ``wanted`` holds."""
        last = None
        for _, (found, data) in zip(range(MOST_EVENTS), self.events(), strict=False):
            if found == name:
                if wanted(data):
                    return data
                last = data
        raise AssertionError(f"no such {name}; the last one was {last}")

    def close(self) -> None:
        """Go away."""
        self.answer.close()
        self._connection.close()
