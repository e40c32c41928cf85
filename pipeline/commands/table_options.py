"""Options for tables beside ranking.csv, the same of every command that writes them."""

from typing import Annotated

import typer

ExcelOption = Annotated[
    str | None,
    typer.Option(
        "--csv",
        metavar="DIALECT",
        help="Also write ranking-excel.csv, which opens in Excel by double click. Dialects: excel, "
        "excel-de, excel-es, excel-fr, excel-it.",
        show_default="none",
    ),
]
ParquetOption = Annotated[
    bool, typer.Option("--parquet", help="Also write ranking.parquet (needs the extra drupe[parquet]).")
]
