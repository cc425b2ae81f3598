"""``autopilot mavlink``: the signing key of a vehicle."""

import hashlib
import secrets
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.click_types import OneOf
from autopilot.cli.completion import CONFIG_NAME
from autopilot.core.errors import ConfigError

if TYPE_CHECKING:
    from autopilot.run.signing_files import SigningFiles


@click.group()
def mavlink() -> None:
    """Signing key of a vehicle."""


@mavlink.command()
@click.argument("action", type=OneOf(["make", "show", "forget"]))
@click.option("--config", "config_file", type=CONFIG_NAME, help="The vehicle's configuration, as for `autopilot run`.")
@click.option("--instance", type=click.IntRange(0, 99), help="The simulated vehicle of this number (with --config: 0).")
@click.option("--passphrase", is_flag=True, help="make: ask for a passphrase (SHA-256 of it, as MAVProxy does).")
@click.option("--force", is_flag=True, help="make: replace the key that is there.")
def key(action: str, config_file: str | None, instance: int | None, passphrase: bool, force: bool) -> None:
    """Make, show or forget the key that frames are signed with.

    The key is printed once, for the ground station; it stands in the vehicle's state folder, readable by its user only.
    A running service takes it at its next start. `make` and `forget` want to know whose: --config or --instance.
    """
    if config_file is None and instance is None and action != "show":
        raise click.UsageError(
            f"key {action}: whose key? Give --config FILE for a vehicle, or --instance 0 for the simulation"
        )
    whose = f"simulation, instance {instance or 0}" if config_file is None else f"vehicle of {config_file}"
    files = _files(_folder(config_file, instance or 0), replace=force and action == "make")
    for warning in files.warnings:
        click.echo(f"warning: {warning}", err=True)
    if action == "show":
        present = files.state.key
        click.echo(f"{whose} ({files.path})", err=True)
        click.echo("no key: frames are not signed" if present is None else present.hex())
    elif action == "forget":
        files.write_key(None)
        click.echo(f"{whose}: no key any more ({files.path}); restart the service")
    else:
        if files.state.key is not None and not force:
            raise click.UsageError(
                f"key make: the {whose} has a key ({files.path}); `show` prints it, --force replaces it, and ground "
                "stations with the old one are not heard any more"
            )
        made = secrets.token_bytes(32)
        if passphrase:
            made = hashlib.sha256(click.prompt("Passphrase", hide_input=True).encode()).digest()
        files.write_key(made)
        click.echo(made.hex())
        click.echo(
            f"{whose}: key made ({files.path}); restart the service, give the key to the ground station", err=True
        )


def _files(folder: Path, *, replace: bool) -> "SigningFiles":
    """The key of a state folder. ``replace``: a file that is no key is no obstacle."""
    from autopilot.run.signing_files import SigningFiles

    try:
        return SigningFiles(folder)
    except ConfigError:
        if not replace:
            raise
        SigningFiles.discard(folder)
        return SigningFiles(folder)


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
