"""Options of a sampling plan, which several commands have."""

from pathlib import Path
from typing import Annotated

import typer

LotSizes = Annotated[
    list[str] | None,
    typer.Option(
        "--lot-size",
        metavar="[LOT=]FRUIT",
        help="Fruit in the whole lot. LOT=FRUIT is the size of one lot of drupe history.",
    ),
]
Aql = Annotated[
    float,
    typer.Option(
        "--aql",
        metavar="PERCENT",
        help="Acceptance quality limit: per cent of nonconforming fruit, 0.01 to 10.",
    ),
]
Level = Annotated[
    str, typer.Option("--level", metavar="LEVEL", help="Inspection level: I, II, III, or S-1 to S-4.")
]
Inspection = Annotated[
    str, typer.Option("--inspection", metavar="KIND", help="normal, tightened or reduced inspection.")
]
Variables = Annotated[
    bool,
    typer.Option("--variables", help="Plan by variables (s method, one limit) instead of by attributes."),
]
OcFile = Annotated[
    Path | None,
    typer.Option(
        "--oc",
        metavar="FILE",
        help="Write the operating characteristic to this table: .csv, .xlsx, .parquet or .json.",
    ),
]
