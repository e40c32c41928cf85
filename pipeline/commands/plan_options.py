"""Options of a sampling plan, which several commands have."""

from pathlib import Path
from typing import Annotated

from typer import Option

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
