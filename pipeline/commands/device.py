"""`drupe device`."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument

from pipeline.safe_start import elsewhere

device = typer.Typer(
    help="Manage the devices that may open the page of `drupe watch` over the network.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
FileArgument = Annotated[Path, Argument(metavar="FILE", help="The file of devices.")]
NameArgument = Annotated[str, Argument(metavar="NAME", help="The device's name.")]


@device.command(short_help="Add a device and print its token.")
def add(file: FileArgument, name: NameArgument) -> None:
    """Add a device to FILE and print its token. FILE holds a hash of it, so no one can print it again.

    Exit status: 0 added; 1 internal error; 2 usage or unusable FILE; 130 interrupted.

    Example: drupe device add devices.json "kiosk at belt 2"
    """
    with elsewhere():
        from pipeline.watch.devices import add_device
    typer.echo(add_device(file, name, now=datetime.now(UTC)))


@device.command(short_help="Revoke a device's token.")
def revoke(file: FileArgument, name: NameArgument) -> None:
    """Remove a device from FILE. Its token and its open pages stop working at once.

    Exit status: 0 revoked; 1 internal error; 2 usage or unusable FILE; 130 interrupted.

    Example: drupe device revoke devices.json "kiosk at belt 2"
    """
    with elsewhere():
        from pipeline.watch.devices import revoke_device
    revoke_device(file, name)
    typer.echo(f"revoked {name}")


@device.command("list", short_help="List the devices.")
def list_devices(file: FileArgument) -> None:
    """List the devices of FILE, each with the day on which it was added.

    Exit status: 0 listed; 1 internal error; 2 usage or unusable FILE; 130 interrupted.

    Example: drupe device list devices.json
    """
    with elsewhere():
        from pipeline.watch.devices import read_devices
    for known_device in read_devices(file):
        typer.echo(f"{known_device.added_utc:%Y-%m-%d}  {known_device.name}")
