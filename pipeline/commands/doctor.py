"""`drupe doctor`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.machine import cores
from pipeline.exit_status import INTERNAL, USAGE
from pipeline.safe_start import elsewhere


def doctor(
    folder: Annotated[
        Path, typer.Argument(metavar="[DIR]", help="Where results would go: its disk is looked at.")
    ] = Path(),
) -> None:
    """Say whether this machine can grade: libraries, threads, memory, disk, and a computation whose answer
    is known (a few seconds).

    Exit status: 0 all well, 1 the computation is wrong, 2 something is missing. Example: drupe doctor
    """
    with elsewhere():
        from pipeline.run.machine_check import machine_check

    found = machine_check(folder, cores=cores())
    for line in found.lines:
        typer.echo(line)
    for sentence in found.missing:
        typer.echo(f"missing: {sentence}")
    if found.wrong:
        typer.echo(f"wrong: {found.wrong}")
        raise typer.Exit(INTERNAL)
    if found.missing:
        raise typer.Exit(USAGE)
    typer.echo("all well")
