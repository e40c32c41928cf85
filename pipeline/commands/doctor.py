"""`drupe doctor`."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument

from pipeline.commands.endings import cores
from pipeline.exit_status import INTERNAL, USAGE
from pipeline.safe_start import elsewhere


def doctor(
    folder: Annotated[
        Path,
        Argument(
            metavar="[DIR]",
            help="The folder for results; drupe checks its disk. Default: the current folder.",
        ),
    ] = Path(),
) -> None:
    """Check whether this machine can grade: libraries, threads, memory, disk and a test computation.

    The test solves a problem with a known answer and takes a few seconds.

    Exit status: 0 all well; 1 wrong result; 2 missing parts; 130 interrupted.

    Example: drupe doctor
    """
    with elsewhere():
        from pipeline.run.machine_check import computation_check, parts_check

    missing: list[str] = []
    for line in parts_check(folder, cores=cores(), missing=missing):
        typer.echo(line)
    for sentence in missing:
        typer.echo(f"missing: {sentence}")
    if missing:
        raise typer.Exit(USAGE)
    line, wrong = computation_check()
    typer.echo(line)
    if wrong:
        typer.echo(f"wrong: {wrong}")
        raise typer.Exit(INTERNAL)
    typer.echo("all well")
