"""What force against displacement of the gels says of each fault, in folders of mismatch cases.

    python benchmarks/gel_fault_floor.py CASE...

A line per case and fault: its parameters as measured, the relation's ln evidence, and the ln likelihood that
the flesh's own equations gain with the fault undone (fem.mismatch.gel_fault). On sound cases these are the
floor of the amounts that can be named.
"""

import argparse
import tempfile
from pathlib import Path

from threadpoolctl import threadpool_limits

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.gel_fault import GelFault
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.procedure import plain_forward_model
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog


def lines_of(forward: ForwardModel) -> list[str]:
    """One line per fault."""
    found = []
    for effect in EFFECTS:
        if not isinstance(effect, GelFault):
            continue
        measured = effect.measured(forward)
        if measured is None:
            found.append(f"{effect.spec.name}: nothing")
            continue
        values = ", ".join(f"{k} {v:.4g} ± {measured.sd[k]:.2g}" for k, v in measured.values.items())
        gain = effect.flesh_gain(forward)
        found.append(f"{effect.spec.name}: {values}, evidence {measured.evidence:.1f}, flesh {gain:+.1f}")
    return found


def main() -> None:
    """Print the lines of every case."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", type=Path, nargs="+")
    for folder in parser.parse_args().cases:
        with tempfile.TemporaryDirectory() as work, threadpool_limits(1):
            case = open_case(folder.resolve(), fruit_id=None, work=Path(work), out=None)
            fruit = grasped_fruit(case.task, StageLog(str))
            forward, _ = plain_forward_model(mismatch_case(case, fruit))
            print("\n    ".join([folder.name, *lines_of(forward)]), flush=True)


if __name__ == "__main__":
    main()
