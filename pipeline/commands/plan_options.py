"""Options of a sampling plan, which several commands have."""

from pathlib import Path
from typing import Annotated

from typer import Option

LotSizes = Annotated[
    list[str] | None,
    Option(
        "--lot-size", metavar="[LOT=]FRUIT", help="Fruit in the whole lot; LOT=FRUIT for one lot of several."
    ),
]
Aql = Annotated[
    float,
    Option("--aql", metavar="PERCENT", help="Acceptance quality limit of nonconforming fruit, 0.01 to 10."),
]
Level = Annotated[
    str, Option("--level", metavar="LEVEL", help="Inspection level: I, II, III, or S-1 to S-4.")
]
Inspection = Annotated[str, Option("--inspection", metavar="KIND", help="normal, tightened or reduced.")]
Variables = Annotated[bool, Option("--variables", help="Plan by variables (s method), not by attributes.")]
OcFile = Annotated[
    Path | None,
    Option(
        "--oc",
        metavar="FILE",
        help="Write the operating characteristic to this .csv, .xlsx, .parquet or .json.",
    ),
]
