"""``autopilot emulate``: a flight controller with a simulated vehicle, to try ``autopilot run`` on."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.click_types import FiniteRange, OneOf
from autopilot.cli.completion import SCENARIO_NAME, VEHICLE_NAME
from autopilot.cli.console_output import emit_json
from autopilot.cli.service_run import StopSignals
from autopilot.cli.shared_options import CAMERA

if TYPE_CHECKING:
    from autopilot.sitl.camera_process import CameraPlace

TRACKED = "udpout:127.0.0.1:14540"
"""An API port of `autopilot run`."""


@click.command()
@click.argument("scenario", type=SCENARIO_NAME, default="paper-tank")
@click.option(
    "--vehicle", type=VEHICLE_NAME, default="bluerov2", show_default=True, help="A shipped vehicle or a vehicle file."
)
@click.option("--frame", type=OneOf(["vectored", "vectored_6dof"]), default="vectored", show_default=True)
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
@CAMERA
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--duration", type=FiniteRange(min=0.0, min_open=True), help="End after so many seconds.")
@click.option("--truth", type=click.Path(dir_okay=False, path_type=Path), help="File for true poses, a JSON line each.")
def emulate(
    scenario: str,
    vehicle: str,
    frame: str,
    link: tuple[str, ...],
    pose: tuple[str, ...],
    camera: "CameraPlace | None",
    seed: int,
    duration: float | None,
    truth: Path | None,
) -> None:
    """Be a BlueROV2 with ArduSub in the water of SCENARIO, in real time, for `autopilot run --config` to fly.

    At its end it prints what has become of the vehicle.
    """
    stop = StopSignals()
    from msgspec import structs

    from autopilot.run.sitl_emulated import emulate as run

    if not pose and camera is None:
        pose = (TRACKED,)
    flight = run(
        scenario,
        vehicle,
        frame,
        links=link,
        pose=[each for each in pose if each != "off"],
        camera=camera,
        seed=seed,
        duration_s=duration,
        truth_file=truth,
        stop=lambda: bool(stop),
        tell=lambda text: click.echo(text, err=True),
    )
    emit_json(structs.asdict(flight))
