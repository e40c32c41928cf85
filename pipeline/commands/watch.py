"""`drupe watch`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.batch_argument import BatchArgument
from pipeline.commands.language_option import LanguageOption, chosen_language
from pipeline.commands.machine import cores, require_libraries
from pipeline.commands.output_options import LogOption, QuietOption, VerboseOption
from pipeline.safe_start import elsewhere


def watch(
    batch: BatchArgument,
    out: Annotated[Path | None, typer.Option(help="Where results go.", show_default="BATCH/results")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Fruit worked on at the same time.")] = 1,
    port: Annotated[
        int,
        typer.Option(min=0, max=65535, help="Port of the page on this machine.", show_default="any free one"),
    ] = 0,
    settle: Annotated[
        float, typer.Option(min=0, help="Seconds without a change after which a fruit's files are whole.")
    ] = 2,
    idle: Annotated[
        float | None,
        typer.Option(
            min=0, help="Minutes without anything new after which watching ends.", show_default="never"
        ),
    ] = None,
    time_limit: Annotated[
        float, typer.Option(min=1, help="Seconds that one fruit may take before it is given up.")
    ] = 1800,
    screen: Annotated[
        bool,
        typer.Option(help="Screen every fruit for physics that the model leaves out (about 10 s each)."),
    ] = True,
    lang: LanguageOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    log: LogOption = None,
) -> None:
    """Grade fruit as their files are put into BATCH/fruits/<fruit_id>, and show the last one in a browser.

    A fruit is graded when it has photos (or fruit.ply) and a recording and its files have been at rest for
    --settle seconds, and again when they change; folders without a row in fruits.csv are fruit too. The page
    shows each fruit as soon as it is graded; ranking and report follow, so often that they take 1 % of the
    time, and at the end. The page is for browsers on this machine, at an address that is printed; Ctrl-C
    ends. Example: drupe watch monday --port 8000
    """
    require_libraries()
    language = chosen_language(lang)
    with elsewhere():
        from rich.console import Console

        from pipeline.batch.layout import BatchFolder, Results
        from pipeline.batch.settings import require_settings_file
        from pipeline.ranking.run_summary import print_summary
        from pipeline.run.console import RunConsole
        from pipeline.watch.page_server import PageServer
        from pipeline.watch.watching import BatchWatch, WatchOptions
        from reports.kiosk_page import kiosk_html
    require_settings_file(BatchFolder(batch).settings)
    console = RunConsole(quiet=quiet, verbose=verbose, log=log)
    place = out or batch / "results"
    options = WatchOptions(
        out=place,
        jobs=min(jobs, cores()),
        time_limit_s=time_limit,
        screen=screen,
        language=language,
        settle_s=settle,
        idle_s=None if idle is None else 60 * idle,
    )

    def tell(sentence: str) -> None:
        console.print(sentence, highlight=False, markup=False, soft_wrap=True)

    with PageServer(Results(place), port=port, tell=tell) as server:
        typer.echo(f"page: {server.address}")
        typer.echo(f"watching {batch}; Ctrl-C ends")
        watching = BatchWatch(
            root=batch,
            options=options,
            console=console,
            show=lambda entry: server.show(kiosk_html(entry, language=language)),
        )
        try:
            status = watching.run()
        except KeyboardInterrupt:
            unfinished = len(watching.graded.working)
            fruit = "a fruit was" if unfinished == 1 else f"{unfinished} fruit were"
            goes_on = f"; {fruit} not finished, the same command goes on from here" if unfinished else ""
            typer.echo(f"drupe: stopped{goes_on}", err=True)
            status = watching.stop()
    if not quiet and watching.graded.reported is not None:
        print_summary(watching.graded.reported, place, console=Console())
    raise typer.Exit(status)
