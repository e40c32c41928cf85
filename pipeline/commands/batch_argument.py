"""The argument that names a batch."""

from pathlib import Path
from typing import Annotated

import typer

BatchArgument = Annotated[
    Path, typer.Argument(metavar="BATCH", help="The batch: a folder with batch.toml and fruits.csv.")
]
