"""``autopilot emulate``: a flight controller with a simulated vehicle, to try ``autopilot run`` on."""

from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.console_output import emit_json
from autopilot.cli.service_run import StopSignals
from autopilot.cli.shared_options import simulated_ardusub

if TYPE_CHECKING:
    from autopilot.sitl.camera_process import CameraPlace

TRACKED = "udpout:127.0.0.1:14540"
"""An API port of `autopilot run`."""


@click.command()
@simulated_ardusub
@click.option(
    "--link",
    multiple=True,
    default=("udpout:127.0.0.1:14555",),
    show_default=True,
    help="Where the flight controller speaks; repeatable.",
)
@click.option(
    "--pose",
    multiple=True,
    help="Where a tracking system sends the vehicle's pose; repeatable. Default: udpout:127.0.0.1:14540, with --camera"
    " none. `off`: none.",
)
def emulate(link: tuple[str, ...], pose: tuple[str, ...], camera: "CameraPlace | None", **given: Any) -> None:
    """Be a BlueROV2 with ArduSub in the water of SCENARIO, in real time, for `autopilot run --config` to fly.

    At its end it prints what has become of the vehicle.
    """
    stop = StopSignals()
    from msgspec import structs

    from autopilot.run.sitl_emulated import emulate as run

    if not pose and camera is None:
        pose = (TRACKED,)
    flight = run(
        link,
        pose=[each for each in pose if each != "off"],
        camera=camera,
        stop=lambda: bool(stop),
        tell=lambda text: click.echo(text, err=True),
        **given,
    )
    emit_json(structs.asdict(flight))
