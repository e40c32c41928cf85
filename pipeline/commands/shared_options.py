"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from pipeline.problem import refused
from reports.language import LANGUAGES, of_environment

BatchArgument = Annotated[
    Path, Argument(metavar="BATCH", help="The batch: a folder with batch.toml and fruits.csv.")
]
OutOption = Annotated[Path | None, Option(help="The folder for results.", show_default="BATCH/results")]
TimeLimitOption = Annotated[float, Option(min=1, help="Time limit per fruit, in seconds.")]
"""At least one second: no fruit takes less."""
ScreenOption = Annotated[
    bool, Option(help="Test every fruit for physics that the model misses (18 to 28 s per fruit).")
]
LanguageOption = Annotated[
    str | None,
    Option(
        "--lang",
        metavar="LANGUAGE",
        help=f"Language of the page: {', '.join(LANGUAGES)}.",
        show_default="from the locale, otherwise en",
    ),
]
QuietOption = Annotated[
    bool, Option("--quiet", "-q", help="Print only errors; the exit status shows the outcome.")
]
VerboseOption = Annotated[
    bool, Option("--verbose", "-v", help="Also print the messages of libraries, with fruit and stage.")
]
SheetOption = Annotated[str | None, Option(metavar="NAME", help="The sheet to read from a spreadsheet.")]
ColumnsOption = Annotated[
    str | None,
    Option(
        metavar="LIST",
        help="Columns of a load cell's table, for example time=Time,force=Force,travel=Pos. Use gap=NAME for "
        "a distance that decreases.",
    ),
]
UnitsOption = Annotated[
    str | None,
    Option(
        metavar="LIST",
        help="Units, if the table does not state them, for example force=N,travel=mm,time=s. Also known: kN, "
        "lbf, kgf, um, in, ms, min and others.",
    ),
]
ResultsArgument = Annotated[Path, Argument(metavar="OUT", help="The results folder of `drupe grade`.")]
MovedBatchOption = Annotated[
    Path | None, Option("--batch", metavar="DIR", help="The batch folder, if it moved after grading.")
]
LotSizes = Annotated[
    list[str] | None,
    Option(
        "--lot-size", metavar="[LOT=]FRUIT", help="Fruit in the whole lot; LOT=FRUIT for one of several lots."
    ),
]
Aql = Annotated[
    float, Option("--aql", metavar="PERCENT", help="Acceptance quality limit, 0.01 to 10 % of the fruit.")
]
Level = Annotated[str, Option("--level", metavar="LEVEL", help="Inspection level: I, II, III, S-1 to S-4.")]
Inspection = Annotated[str, Option("--inspection", metavar="KIND", help="normal, tightened or reduced.")]
Variables = Annotated[bool, Option("--variables", help="Plan by variables (s method), not by attributes.")]
OcFile = Annotated[
    Path | None, Option("--oc", metavar="FILE", help="Write the operating characteristic as a table.")
]


def chosen_language(asked: str | None) -> str:
    """The language `asked`; None: the environment's. Raises BatchRefused for an unknown language."""
    if asked is None:
        return of_environment()
    if asked not in LANGUAGES:
        raise refused("--lang", f'found "{asked}", expected one of {", ".join(LANGUAGES)}.')
    return asked
