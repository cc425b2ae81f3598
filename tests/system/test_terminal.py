"""What a terminal is shown and a pipe is not: colours, bars; and what NO_COLOR keeps away from both."""

import os
import pty
import re
import subprocess
import sys

import pytest
from click.testing import CliRunner

from autopilot.cli.campaign import campaign
from autopilot.cli.main import cli

SAID = """
from autopilot.cli.demo_command import _progress
from autopilot.cli.log import print_rows
from autopilot.log.rows import BoundRow, BoundVerdict

with _progress("tank", quiet=False) as show:
    show("mission active", 1, 7)
    show("mission active", 1, 7)
    show("mission active", 2, 7)
make = lambda name, verdict: BoundRow(name=name, unit="m", limit=1.0, worst=0.5, margin=0.5, verdict=verdict)
print_rows([make("good", BoundVerdict.PASS), make("bad", BoundVerdict.FAIL)], "title")
"""
COLOR = re.compile(r"\x1b\[[\d;]*\b(?:3[0-7]|9[0-7]|38;\d[\d;]*)m")
ESCAPE = "\x1b"


def on_terminal(**environment: str) -> str:
    ours, theirs = pty.openpty()
    kept = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "FORCE_COLOR")}
    child = subprocess.Popen(
        [sys.executable, "-c", SAID],
        stdout=theirs,
        stderr=theirs,
        env={**kept, "TERM": "xterm-256color", **environment},
    )
    os.close(theirs)
    heard = b""
    while True:
        try:
            data = os.read(ours, 65536)
        except OSError:  # the other end is closed
            break
        if not data:
            break
        heard += data
    os.close(ours)
    assert child.wait() == 0, heard.decode()
    return heard.decode()


def test_a_terminal_is_shown_colours_and_a_bar() -> None:
    heard = on_terminal()
    assert COLOR.search(heard) and "2/7" in heard and "tank: mission active, waypoint" not in heard


@pytest.mark.parametrize("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}], ids=str)
def test_colours_can_be_refused(environment: dict[str, str]) -> None:
    heard = on_terminal(**environment)
    assert not COLOR.search(heard) and "bad" in heard


def test_a_pipe_gets_plain_lines() -> None:
    done = subprocess.run([sys.executable, "-c", SAID], capture_output=True, text=True, check=True)
    assert ESCAPE not in done.stdout + done.stderr
    assert done.stderr.splitlines() == [
        "tank: mission active, waypoint 1 of 7",
        "tank: mission active, waypoint 2 of 7",
    ]


def test_help_of_a_campaign_names_its_other_commands() -> None:
    done = CliRunner().invoke(campaign, ["--help"])
    assert done.exit_code == 0 and "--runs" in done.output
    for name in ("table", "rooms", "faults"):
        assert f"campaign {name}" in done.output


def test_help_lines_say_one_thing_each() -> None:
    """Nothing in the list of commands is cut off or wrapped more than once at 80 columns."""
    done = CliRunner().invoke(cli, ["--help"], terminal_width=80)
    listed = done.output.split("Commands:")[1].splitlines()
    names = [line.split()[0] for line in listed if re.match(r"^  \w", line)]
    assert names == sorted(names) and {"demo", "sitl", "run", "log", "mission"} <= set(names)
    assert len([line for line in listed if line.strip()]) <= 1.3 * len(names) and "..." not in "".join(listed)
