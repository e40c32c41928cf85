"""`drupe grade`."""

from typing import Annotated

import typer
from rich.console import Console
from typer import Option

from pipeline.batch.batch_place import require_folder
from pipeline.commands.endings import cores, exit_when_interrupted, require_libraries
from pipeline.commands.shared_options import (
    BatchArgument,
    LanguageOption,
    OutOption,
    QuietOption,
    ScreenOption,
    TimeLimitOption,
    VerboseOption,
    chosen_language,
)
from pipeline.safe_start import elsewhere


def grade(
    batch: BatchArgument,
    out: OutOption = None,
    jobs: Annotated[
        int | None, Option(min=1, help="Number of fruit to compute in parallel.", show_default="one per core")
    ] = None,
    time_limit: TimeLimitOption = 1800,
    force: Annotated[
        bool, Option("--force", help="Accept values outside the category's plausible range.")
    ] = False,
    screen: ScreenOption = True,
    scheduler: Annotated[
        str | None,
        Option(
            metavar="ADDRESS",
            help="Grade on several machines with this dask scheduler, for example tcp://node1:8786. "
            "All machines must share the file system with BATCH and OUT.",
        ),
    ] = None,
    slurm: Annotated[
        bool,
        Option(
            "--slurm",
            help="Grade on a Slurm cluster. --jobs sets the number of Slurm jobs; each computes one "
            "fruit at a time.",
        ),
    ] = False,
    lang: LanguageOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Grade a batch: compute E of every fruit and write ranking.csv and report.html.

    A second run computes only missing or changed fruit.

    Exit status: 0 all graded; 1 internal error; 2 usage or settings; 3 some fruit not graded; 4 all graded
    but some E in doubt or a reference body failed its check; 130 interrupted.

    Example: drupe grade monday --jobs 4
    """
    require_folder(batch)
    require_libraries()
    language = chosen_language(lang)
    with elsewhere():
        from pipeline.ranking.run_summary import print_summary
        from pipeline.run.batch_run import GradeOptions
        from pipeline.run.grading import grade as grade_batch
        from pipeline.run.progress import RunConsole
        from pipeline.run.scheduling import WorkPlace

    with exit_when_interrupted("; drupe kept the finished fruit. Run the same command again to continue."):
        status, entry = grade_batch(
            batch,
            out,
            GradeOptions(
                jobs=jobs or cores(),
                time_limit_s=time_limit,
                screen=screen,
                force=force,
                language=language,
                place=WorkPlace(jobs=jobs, scheduler=scheduler, slurm=slurm),
            ),
            console=RunConsole(quiet=quiet, verbose=verbose),
        )
    if not quiet:
        print_summary(entry, out or batch / "results", console=Console())
    raise typer.Exit(status)
