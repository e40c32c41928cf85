"""`drupe plan`."""

import typer

from pipeline.commands.shared_options import Aql, Inspection, Level, LotSizes, OcFile, Variables
from pipeline.safe_start import elsewhere


def plan(
    lot_size: LotSizes = None,
    aql: Aql = 4.0,
    level: Level = "II",
    inspection: Inspection = "normal",
    variables: Variables = False,
    oc: OcFile = None,
) -> None:
    """Show how many fruit of a lot to inspect, and when to accept the lot.

    Plans by attributes are those of MIL-STD-105E, which ISO 2859-1 shares for normal and tightened
    inspection. Plans by variables are those of ANSI/ASQ Z1.9 (ISO 3951:1989), s method, one limit; in
    reduced inspection k corresponds to M of table B-4.
    drupe history --accept applies a plan to lots.

    Exit status: 0 done; 1 internal error; 2 usage; 130 interrupted.

    Example: drupe plan --lot-size 5000 --aql 4 --oc curve.csv
    """
    with elsewhere():
        from pipeline.history.lot_acceptance import PlanWanted
        from pipeline.history.lot_quality import sampling_plan

    wanted = PlanWanted(
        lot_size=tuple(lot_size or ()), aql=aql, level=level, inspection=inspection, variables=variables
    )
    for line in sampling_plan(wanted, oc):
        typer.echo(line)
