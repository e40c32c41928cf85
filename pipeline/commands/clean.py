"""`drupe clean`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.safe_start import elsewhere


def clean(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Results of `drupe grade`.")],
    everything: Annotated[
        bool, typer.Option("--all", help="Remove ranking, report and records too.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would go; remove nothing.")] = False,
) -> None:
    """Remove what drupe keeps between runs (meshes, elements, responses); results stay unless --all.

    Only files that drupe wrote and nobody has changed are removed, and no link is followed. The next
    `drupe grade` computes the fruit again. Example: drupe clean monday/results --dry-run
    """
    with elsewhere():
        from pipeline.run.cleaning import clean as clean_results
    done = clean_results(out, everything=everything, dry=dry_run)
    would = "would be removed" if dry_run else "removed"
    typer.echo(f"{out}: {len(done.removed)} files, {done.size_bytes / 1e6:.1f} MB {would}")
    for path in done.left:
        typer.echo(f"left: {path}: not written by drupe, or changed since")
