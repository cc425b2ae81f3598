"""``autopilot log view``: the live view's page plays a log."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.shared_options import LOG_FILE
from autopilot.core.errors import AutopilotError
from autopilot.run.config import MAX_PORT

if TYPE_CHECKING:
    from autopilot.core.vehicle import Vehicle
    from autopilot.log.reader import Log

DEFAULT_VEHICLE = "lbv150"
POLL_S = 0.2


@click.command()
@LOG_FILE
@click.option(
    "--port",
    type=click.IntRange(0, MAX_PORT),
    help="Port on 127.0.0.1, 0 = any (default: 8760, or the next that is free).",
)
def view(log_file: Path, port: int | None) -> None:
    """Play LOG in the page of the live view, on 127.0.0.1, until Ctrl-C."""
    from autopilot.cli.service_run import StopSignals
    from autopilot.log.reader import open_log
    from autopilot.run.sitl_world_view import logged_world
    from autopilot.view.http_server import ViewServer
    from autopilot.view.log_frames import LogFrames

    opened = open_log(log_file)
    world, unknown = logged_world(opened)
    if unknown:
        click.echo(f"warning: {log_file}: {unknown}; obstacles are shown as described, without the current", err=True)
    frames = LogFrames(opened, _vehicle(opened), world)
    if opened.problems:
        click.echo(f"warning: {log_file}: {'; '.join(opened.problems)}; only what is readable is shown", err=True)
    server = ViewServer(port, frames, "--port")
    stop = StopSignals()
    click.echo(f"view: {server.url}")
    try:
        while not stop:
            time.sleep(POLL_S)
    finally:
        server.close()


def _vehicle(log: "Log") -> "Vehicle":
    """The vehicle file of the run; of a log without it the shipped one of that name, else the default."""
    from autopilot.core.vehicle import load_vehicle
    from autopilot.record.estimator_setup import read_vehicle

    try:
        return read_vehicle(log)
    except AutopilotError as error:
        name = log.run.get("vehicle", "")
        try:
            vehicle = load_vehicle(name or DEFAULT_VEHICLE)
        except AutopilotError:
            name, vehicle = DEFAULT_VEHICLE, load_vehicle(DEFAULT_VEHICLE)
        click.echo(f"warning: {error}; drawn as {name or DEFAULT_VEHICLE}", err=True)
        return vehicle
