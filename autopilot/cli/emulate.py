"""``autopilot emulate`` and ``physics``: a flight controller with a simulated vehicle, to try ``autopilot run`` on, and
the water and the hull under ArduPilot's own simulation."""

from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.console_output import emit_json
from autopilot.cli.service_run import StopSignals
from autopilot.cli.shared_options import JSON, host_and_port, simulated_ardusub

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

    from autopilot.run.sitl_physics import emulate as run

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


@click.command()
@simulated_ardusub
@click.option(
    "--listen",
    default="127.0.0.1:9002",
    callback=host_and_port,
    show_default=True,
    metavar="HOST:PORT",
    help="For ArduPilot.",
)
@click.option("--pose", multiple=True, help="Where a tracking system sends the vehicle's pose; repeatable.")
@JSON
def physics(scenario: str, listen: tuple[str, int], as_json: bool, **given: Any) -> None:
    """Be the hull, the thrusters and the water of SCENARIO for ArduSub's simulation (--model JSON).

    ArduSub flies, and its MAVLink is on its own ports; at the end this prints what has become of the vehicle.
    """
    stop = StopSignals()
    import msgspec

    from autopilot.run.sitl_physics import home_of, serve_physics
    from autopilot.sitl.scenario import load_scenario

    if not as_json:
        click.echo(f"ardusub --model JSON:{listen[0]} --home {home_of(load_scenario(scenario))}")
    flight = serve_physics(
        listen,
        scenario=scenario,
        stop=lambda: bool(stop),
        tell=lambda text: click.echo(text, err=True),
        **given,
    )
    if as_json:
        emit_json(msgspec.to_builtins(flight))
    else:
        for name, value in msgspec.to_builtins(flight).items():
            click.echo(f"{name}: {value}")
