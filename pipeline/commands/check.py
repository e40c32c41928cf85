"""`drupe check`."""

from typing import Annotated

import typer
from rich.console import Console
from typer import Option

from pipeline.batch.batch_place import require_folder
from pipeline.commands.endings import require_libraries
from pipeline.commands.shared_options import BatchArgument
from pipeline.exit_status import DONE, DOUBTED, USAGE
from pipeline.safe_start import elsewhere


def check(
    batch: BatchArgument,
    quick: Annotated[
        bool,
        Option("--quick", help="Read the photos but skip the image checks. Saves some seconds per fruit."),
    ] = False,
) -> None:
    """Check a batch for problems without computing.

    A problem stops the batch or one of its fruit. A finding marked "E will be in doubt" widens the error bar
    of E. A remark names unused files, photos to retake and sides without a photo.

    Exit status: 0 no findings; 1 internal error; 2 problems; 4 findings that put E in doubt, or remarks; 130
    interrupted.

    Example: drupe check monday --quick
    """
    require_folder(batch)
    require_libraries()
    with elsewhere():
        from pipeline.run.checking import check as problems_of
        from pipeline.run.progress import StageLines
    listed_problems = []
    console = Console(stderr=True)
    console.quiet = not console.is_terminal  # in a log the problems are enough
    report = StageLines(console).stage
    for problem in problems_of(batch, quick=quick, report=report):
        typer.echo(f"{problem}")
        listed_problems.append(problem)
    doubts = sum(problem.doubtful for problem in listed_problems)
    remarks = sum(problem.remark for problem in listed_problems)
    problems = len(listed_problems) - doubts - remarks
    more = f", and {_so_many(doubts, 'finding')} that will put E in doubt" if doubts else ""
    more += f", and {_so_many(remarks, 'remark')}" if remarks else ""
    typer.echo(f"{_so_many(problems, 'problem')} found in {batch}{more}")
    raise typer.Exit(USAGE if problems else DOUBTED if doubts or remarks else DONE)


def _so_many(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
