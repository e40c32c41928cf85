"""`drupe watch`."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from pipeline.batch.batch_place import require_folder
from pipeline.commands.endings import cores, require_libraries
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


def watch(
    batch: BatchArgument,
    out: OutOption = None,
    jobs: Annotated[int, Option(min=1, help="Number of fruit to compute in parallel.")] = 1,
    port: Annotated[
        int, Option(min=0, max=65535, help="Port of the page on this machine.", show_default="any free one")
    ] = 0,
    host: Annotated[
        str, Option(help="Address to listen at. Any other than this machine's own needs the next three.")
    ] = "127.0.0.1",
    certificate: Annotated[
        Path | None, Option(metavar="FILE", help="TLS certificate of this machine, PEM.")
    ] = None,
    key: Annotated[Path | None, Option(metavar="FILE", help="Its key, PEM, without a password.")] = None,
    devices: Annotated[
        Path | None, Option(metavar="FILE", help="Devices that may open the page (drupe device).")
    ] = None,
    settle: Annotated[
        float, Option(min=0, help="Wait until a fruit's files are unchanged for this time, in seconds.")
    ] = 2,
    idle: Annotated[
        float | None,
        Option(min=0, help="Stop after this time without new files, in minutes.", show_default="never"),
    ] = None,
    time_limit: TimeLimitOption = 1800,
    screen: ScreenOption = True,
    lang: LanguageOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Grade fruit as their files arrive in BATCH/fruits/<fruit_id>, and show the latest fruit in a browser.

    drupe grades a fruit that has photos (or fruit.ply) and a recording, once its files are unchanged for
    --settle seconds. drupe grades it again when its files change. A folder without a row in fruits.csv also
    counts as a fruit.

    The page shows each fruit when its grade is ready, and takes a person's verdict on it. Only browsers on
    this machine can open it. drupe prints its address. With --host, --certificate, --key and --devices,
    devices on the network open it over TLS, each with its own token. Ranking and report follow at intervals
    that keep their cost near 1 % of the time, and at the end. Press Ctrl-C to stop.

    Exit status, of the last report: 0 all graded; 1 internal error; 2 usage or settings; 3 some fruit not
    graded; 4 all graded but some E in doubt or a reference body failed its check; 130 stopped with fruit
    unfinished.

    Example: drupe watch monday --port 8000
    """
    require_folder(batch)
    require_libraries()
    language = chosen_language(lang)
    with elsewhere():
        from rich.console import Console

        from pipeline.batch.layout import BatchFolder, Results
        from pipeline.batch.settings_file import require_settings_file
        from pipeline.ranking.run_summary import print_summary
        from pipeline.run.batch_run import GradeOptions
        from pipeline.run.progress import RunConsole, say
        from pipeline.watch.device_login import network_of
        from pipeline.watch.page_server import PageServer
        from pipeline.watch.verdict_desk import VerdictDesk
        from pipeline.watch.watching import BatchWatch, WatchOptions
    require_settings_file(BatchFolder(batch).settings)
    network = network_of(host, certificate=certificate, key=key, devices=devices)
    console = RunConsole(quiet=quiet, verbose=verbose)
    place = out or batch / "results"
    options = WatchOptions(
        out=place,
        grading=GradeOptions(
            jobs=min(jobs, cores()), time_limit_s=time_limit, screen=screen, language=language
        ),
        settle_s=settle,
        idle_s=None if idle is None else 60 * idle,
    )

    with PageServer(
        Results(place), port=port, network=network, language=language, tell=partial(say, console)
    ) as server:
        typer.echo(f"page: {server.address}")
        typer.echo(f"watching {batch}; press Ctrl-C to stop")
        watching = BatchWatch(
            root=batch, options=options, console=console, show=lambda entry: desk.show_entry(entry)
        )
        desk = VerdictDesk(
            results=Results(place),
            language=language,
            show=server.show,
            kept=watching.judged,
            logout=network is not None,
        )
        server.desk = desk
        try:
            status = watching.run()
        except KeyboardInterrupt:
            unfinished = len(watching.working)
            fruit = "a fruit was" if unfinished == 1 else f"{unfinished} fruit were"
            goes_on = f"; {fruit} not finished. Run the same command again to continue." if unfinished else ""
            typer.echo(f"drupe: stopped{goes_on}", err=True)
            status = watching.stop()
    if not quiet and watching.reported is not None:
        print_summary(watching.reported, place, console=Console())
    raise typer.Exit(status)
