"""Options of ``autopilot sitl`` and ``autopilot run``, and their viewers."""

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.click_types import FiniteRange
from autopilot.run.config import ANY_VIEW_PORT, MAX_PORT, is_part, name_to_use

if TYPE_CHECKING:
    from autopilot.view.foxglove import FoxgloveServer
    from autopilot.view.hub import Hub


def part_name(_: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Callback of an option that names a controller, an estimator or a plant: a shipped one, a package's, or
    package:Class. The name, if there may be such a part."""
    kind = str(param.name)
    if value is not None and not is_part(kind, value):
        raise click.BadParameter(f"{value!r} is not known; {name_to_use(kind, value)}")
    return value


PLAN = click.option("--plan", type=click.Path(exists=True, dir_okay=False), help="Preload mission, fence and rally.")
DURATION = click.option("--duration", type=FiniteRange(min=0.0, min_open=True), help="End after so many seconds.")
LOG = click.option(
    "--log", type=click.Path(dir_okay=False), help="Log file (default: one per arming in the log folder)."
)
LOG_CAMERA_HZ = click.option(
    "--log-camera-hz", type=FiniteRange(0.0, 100.0), help="Pictures in the log per second (default 2)."
)


def _port(_: click.Context, __: click.Parameter, value: str | None) -> int | None:
    """A port; anything else after ``--view`` is probably the next argument."""
    if value is None:
        return None
    if not value.lstrip("-").isdecimal():
        raise click.BadParameter(f"{value!r} is no port; write it before --view, or give a port: --view 8760 {value}")
    if not ANY_VIEW_PORT <= int(value) <= MAX_PORT:
        raise click.BadParameter(f"{value} is no port; use 0 (any) to {MAX_PORT}")
    return int(value)


view_option: Callable[[Any], Any] = click.option(
    "--view",
    callback=_port,
    is_flag=False,
    flag_value=str(ANY_VIEW_PORT),
    metavar="[PORT]",
    help="Live view: a page on 127.0.0.1 (default port 8760, or the next that is free).",
)

view_address_option: Callable[[Any], Any] = click.option(
    "--view-address", help="Of the interface that --view listens on (default 127.0.0.1); 0.0.0.0: all, for everybody."
)


FOXGLOVE_PORT = 8765
"""Foxglove's default port."""

foxglove_option: Callable[[Any], Any] = click.option(
    "--foxglove",
    type=click.IntRange(0, MAX_PORT),
    is_flag=False,
    flag_value=FOXGLOVE_PORT,
    metavar="[PORT]",
    help=f"Topics of the log live on ws://127.0.0.1:PORT for Foxglove (default port {FOXGLOVE_PORT}).",
)


@contextlib.contextmanager
def opened_foxglove(port: int | None) -> Iterator["FoxgloveServer | None"]:
    """The server for Foxglove, None without ``--foxglove``. Its address is printed. ConfigError if it cannot be had."""
    if port is None:
        yield None
        return
    from autopilot.view.foxglove import FoxgloveServer

    server = FoxgloveServer(port)
    click.echo(f"foxglove: {server.url}")
    try:
        yield server
    finally:
        server.close()


@contextlib.contextmanager
def opened_view(port: int | None, address: str = "127.0.0.1") -> Iterator["Hub | None"]:
    """The live view, None without ``--view``. Its URL is printed, also with ``--quiet``. ConfigError if the port
    of that address cannot be had."""
    if port is None:
        yield None
        return
    from autopilot.view.http_server import ViewServer

    server = ViewServer(None if port == ANY_VIEW_PORT else port, address=address)
    click.echo(f"view: {server.url}")
    try:
        yield server.hub
    finally:
        server.close()
