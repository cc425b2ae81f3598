"""``autopilot physics``: the water and the hull under ArduPilot's own simulation."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.click_types import FiniteRange, OneOf
from autopilot.cli.completion import SCENARIO_NAME, VEHICLE_NAME
from autopilot.cli.console_output import emit_json
from autopilot.cli.service_run import StopSignals
from autopilot.cli.shared_options import CAMERA, JSON, host_and_port

if TYPE_CHECKING:
    from autopilot.sitl.camera_process import CameraPlace


@click.command()
@click.argument("scenario", type=SCENARIO_NAME, default="paper-tank")
@click.option(
    "--vehicle", type=VEHICLE_NAME, default="bluerov2", show_default=True, help="A shipped vehicle or a vehicle file."
)
@click.option("--frame", type=OneOf(["vectored", "vectored_6dof"]), default="vectored", show_default=True)
@click.option(
    "--listen",
    default="127.0.0.1:9002",
    callback=host_and_port,
    show_default=True,
    metavar="HOST:PORT",
    help="For ArduPilot.",
)
@click.option("--pose", multiple=True, help="Where a tracking system sends the vehicle's pose; repeatable.")
@CAMERA
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--duration", type=FiniteRange(min=0.0, min_open=True), help="End after so many simulated seconds.")
@click.option("--truth", type=click.Path(dir_okay=False, path_type=Path), help="File for true poses, a JSON line each.")
@JSON
def physics(
    scenario: str,
    vehicle: str,
    frame: str,
    listen: tuple[str, int],
    pose: tuple[str, ...],
    camera: "CameraPlace | None",
    seed: int,
    duration: float | None,
    truth: Path | None,
    as_json: bool,
) -> None:
    """Be the hull, the thrusters and the water of SCENARIO for ArduSub's simulation (--model JSON).

    ArduSub flies, and its MAVLink is on its own ports; at the end this prints what has become of the vehicle.
    """
    stop = StopSignals()
    import msgspec

    from autopilot.run.sitl_physics import home_of, serve_physics
    from autopilot.sitl.scenario import load_scenario

    host, port = listen
    if not as_json:
        click.echo(f"ardusub --model JSON:{host} --home {home_of(load_scenario(scenario))}")
    flight = serve_physics(
        scenario,
        vehicle,
        frame,
        host=host,
        port=port,
        pose=pose,
        camera=camera,
        seed=seed,
        duration_s=duration,
        truth_file=truth,
        stop=lambda: bool(stop),
        tell=lambda text: click.echo(text, err=True),
    )
    if as_json:
        emit_json(msgspec.to_builtins(flight))
    else:
        for name, value in msgspec.to_builtins(flight).items():
            click.echo(f"{name}: {value}")
