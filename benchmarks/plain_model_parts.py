"""What parts of the finder's plain model do for a case: its linear round with all of them, and without one.

    python benchmarks/plain_model_parts.py CASE...

Of each folder of a mismatch case: what finer elements under the pads add to each recording's response
(fem.mismatch.evidence.withheld_response), um rms over the markers that touch; then p-value, statistics,
shares found and best effects of the linear round, with all parts, without large deformation
(fem.mismatch.evidence.large_deformation) and, where anything is added, without that, on the same mesh.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.large_deformation import LARGE_DEFORMATION, leave_large_deformation
from fem.mismatch.evidence.turned_fruit import TURNED_FRUIT
from fem.mismatch.evidence.withheld_response import WITHHELD, leave_withheld, withheld_response
from fem.mismatch.model.forward_model import ForwardModel, MemoTable
from fem.mismatch.procedure import detected, plain_forward_model
from fem.mismatch.selection.screening import screened
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog

SHARES = (LARGE_DEFORMATION, TURNED_FRUIT, WITHHELD)
SHOWN = 4


def linear_line(forward: ForwardModel) -> str:
    """p-value, statistics, shares, and the gain and amounts of the effects that gain most."""
    recorded = [GraspEquations.of(forward, recording) for recording in forward.base.grasps]
    linear = screened(forward, recorded, EFFECTS)
    found = detected(linear, recorded, forward.compliance_ratio)
    best = ", ".join(
        f"{one.name} {one.gain:.1f} nats ({', '.join(f'{x:.3g}' for x in one.amounts)})"
        for one in linear.best[:SHOWN]
    )
    said = " ".join(f"{name} {value:.3f}" for name, value in found.statistics.items())
    amounts = {
        name: share for name in SHARES if (share := linear.products.amount_of(name, linear.null)) is not None
    }
    shares = ", ".join(f"{name} {value:.2f} +- {sd:.2f}" for name, (value, sd) in amounts.items())
    modulus = 1 / (forward.compliance * (1 + float(linear.null.amounts[0])))
    return f"p {found.p_value:.3f}, E {modulus:.4g} MPa, {said}; {shares or 'no shares'}: {best}"


def added_um(forward: ForwardModel) -> list[float]:
    """What finer elements add to each recording's response, um rms; nothing where they are left out."""
    found = []
    for recording in forward.base.grasps:
        added = withheld_response(forward, recording)
        touching = recording.tracks.episode >= 0
        size = 0.0 if added is None else float(np.sqrt((added[touching] ** 2).mean()))
        found.append(1e3 * forward.compliance * size)
    return found


def lines_of(forward: ForwardModel) -> Iterator[str]:
    """What is added, and the linear rounds."""
    started = time.process_time()
    added = added_um(forward)
    seconds = time.process_time() - started
    dofs = 3 * len(forward.base.mesh.nodes_mm)
    yield f"{dofs} dofs, added {' '.join(f'{one:.2f}' for one in added)} um ({seconds:.1f} s of CPU)"
    yield f"all parts                 {linear_line(forward)}"
    small = replace(forward, memo=MemoTable())
    leave_large_deformation(small)
    yield f"without large deformation {linear_line(small)}"
    if any(added):
        coarse = replace(forward, memo=MemoTable())
        for recording in coarse.base.grasps:
            leave_withheld(coarse, recording)
        yield f"without finer elements    {linear_line(coarse)}"


def main() -> None:
    """A case after the other."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="+", type=Path)
    for folder in parser.parse_args().cases:
        with tempfile.TemporaryDirectory() as work:
            case = open_case(folder, fruit_id=None, work=Path(work), out=None)
            handed = mismatch_case(case, grasped_fruit(case.task, StageLog(str)))
            forward, _ = plain_forward_model(handed)
        for line in lines_of(forward):
            print(folder.name, line, flush=True)


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
