"""``autopilot motors``: turn thrusters one by one, on the bench."""

import click

from autopilot.cli.click_types import Finite
from autopilot.cli.service_run import StopSignals
from autopilot.cli.shared_options import CONFIG
from autopilot.core.errors import ConfigError


@click.command()
@CONFIG
@click.option("--thruster", multiple=True, help="Name in the vehicle file; repeatable (default: all in turn).")
@click.option("--level", type=Finite(), default=15.0, show_default=True, help="Percent of the span, -30 to 30.")
@click.option("--seconds", type=Finite(), default=1.0, show_default=True, help="Each, at most 5.")
@click.option("--yes", is_flag=True, help="Do not ask: everybody is clear of the thrusters.")
def motors(config: str, thruster: tuple[str, ...], level: float, seconds: float, yes: bool) -> None:
    """Turn thrusters one by one, a little: is it the right one, does it push the right way?

    The service must not run meanwhile. Ctrl-C stops them.
    """
    from autopilot.run.motor_test import chosen, pulses, turn
    from autopilot.run.vehicle_config import load_config

    loaded = load_config(config)
    setup = loaded.devices.get("thrusters")
    if setup is None:
        raise ConfigError(f"{loaded.path}: the thrusters are the flight controller's; test them with its own tool")
    vehicle = loaded.vehicle
    tests = [(place, list(pulses(vehicle, place, level, seconds))) for place in chosen(vehicle, thruster)]
    names = ", ".join(vehicle.thrusters[place].name for place, _ in tests)
    if not yes:
        click.echo(f"{names}: {level:g} % for {seconds:g} s each, by {setup.driver}.")
        click.confirm("Vehicle held, fingers and hair clear of the thrusters, service stopped?", abort=True)
    stop = StopSignals()
    with setup.make(vehicle) as output:
        for place, commands in tests:
            x, y, z = vehicle.thrusters[place].direction_frd
            direction = "" if level > 0.0 else "against "
            click.echo(f"{vehicle.thrusters[place].name}: pushes {direction}({x:g}, {y:g}, {z:g}) forward, right, down")
            if not turn(output, iter(commands), lambda: bool(stop)):
                raise click.Abort
