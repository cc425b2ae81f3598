"""``autopilot mavlink``: the signing key of a vehicle."""

import hashlib
import secrets
from pathlib import Path

import click


@click.group()
def mavlink() -> None:
    """Signing key of a vehicle."""


@mavlink.command()
@click.argument("action", type=click.Choice(["make", "show", "forget"]))
@click.option("--config", "config_file", help="The vehicle's configuration, as for `autopilot run`; without it SITL's.")
@click.option("--instance", type=click.IntRange(0, 99), default=0, show_default=True, help="Number of the vehicle.")
@click.option("--passphrase", is_flag=True, help="make: ask for a passphrase (SHA-256 of it, as MAVProxy does).")
def key(action: str, config_file: str | None, instance: int, passphrase: bool) -> None:
    """Make, show or forget the key that frames are signed with.

    The key is printed once, for the ground station; it stands in the vehicle's state folder, readable by its user only.
    A running service takes it at its next start.
    """
    from autopilot.run.signing_files import SigningFiles

    files = SigningFiles(_folder(config_file, instance))
    for warning in files.warnings:
        click.echo(f"warning: {warning}", err=True)
    if action == "show":
        present = files.state.key
        click.echo("no key: frames are not signed" if present is None else present.hex())
    elif action == "forget":
        files.write_key(None)
        click.echo(f"{files.path}: no key; restart the service")
    else:
        made = secrets.token_bytes(32)
        if passphrase:
            made = hashlib.sha256(click.prompt("Passphrase", hide_input=True).encode()).digest()
        files.write_key(made)
        click.echo(made.hex())
        click.echo(f"{files.path}: key made; restart the service, give the key to the ground station", err=True)


def _folder(config_file: str | None, instance: int) -> Path:
    """The state folder of a vehicle."""
    from autopilot.run.config import gather, sitl_defaults, vehicle_defaults

    if config_file is None:
        from autopilot.run.sitl_params import state_folder

        return state_folder(gather(sitl_defaults(instance), {}), instance)
    from autopilot.run.hardware_session import state_folder as vehicle_folder
    from autopilot.run.vehicle_config import load_config

    loaded = load_config(config_file)
    given = loaded.file.service.given(loaded.path.parent)
    settings = gather(vehicle_defaults(instance), {}, file=given, file_name=loaded.path.name)
    return vehicle_folder(settings, loaded, instance)
