"""`drupe clean`."""

from typing import Annotated

import typer

from pipeline.commands.shared_options import ResultsArgument
from pipeline.safe_start import elsewhere


def clean(
    out: ResultsArgument,
    everything: Annotated[
        bool, typer.Option("--all", help="Also remove ranking, report and records.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="List the files to remove, and remove nothing.")
    ] = False,
) -> None:
    """Remove the files that drupe keeps to avoid recomputation: meshes, elements and responses.

    Results stay, unless you give --all. drupe removes only files that it wrote and that nobody changed.
    drupe follows no links. The next `drupe grade` computes the fruit again.

    Example: drupe clean monday/results --dry-run
    """
    with elsewhere():
        from pipeline.run.cleaning import clean as clean_results
    done = clean_results(out, everything=everything, dry=dry_run)
    would = "would be removed" if dry_run else "removed"
    typer.echo(f"{out}: {len(done.removed)} files, {done.size_bytes / 1e6:.1f} MB {would}")
    for path in done.left:
        typer.echo(f"kept: {path}: drupe did not write this file, or somebody changed it")
