"""A flight of the paper's mission whose live view is open: for the pictures of it."""

import contextlib
import os
import re
import subprocess
import tempfile
from collections.abc import Iterator

from autopilot.run.children import autopilot_command

AT_S = 20.0
"""Vehicle time of the pictures of the view."""


@contextlib.contextmanager
def viewed_flight(port: int, *options: str) -> Iterator[int]:
    """The port of the page, while the vehicle flies. ``port``: where it listens for clients, so that nobody else's
    service is in the way; ``options`` of ``sitl``."""
    with tempfile.TemporaryDirectory() as folder:
        command = autopilot_command(
            *("sitl", "paper-tank", "--start", "--view", "0", "--connect", f"udpin:127.0.0.1:{port}"),
            *("--log", f"{folder}/run.mcap", *options),
        )
        environment = {**os.environ, "AUTOPILOT_STATE_DIR": folder, "AUTOPILOT_LOG_DIR": folder}
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        try:
            assert process.stdout is not None
            found = re.search(r":(\d+)/", process.stdout.readline())
            assert found is not None, "the process has not printed where its view is"
            yield int(found[1])
        finally:
            process.terminate()
            process.communicate()
