"""What the finder's one mesh withholds of small patches, and what it makes sound fruit seem to have.

    python benchmarks/withheld_by_mesh.py CASE...

Of each folder of a mismatch case: what finer elements under the pads add to each recording's response, um rms
over the markers that touch; then the linear round's p-value, statistics and best effects with that in the
plain model (fem.mismatch.evidence.withheld_response) and without it, on the same mesh.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.linear_evidence import GraspEquations
from fem.mismatch.evidence.withheld_response import leave_withheld, withheld_response
from fem.mismatch.model.forward_model import ForwardModel, MemoTable
from fem.mismatch.procedure import detection_statistics, plain_forward_model
from fem.mismatch.selection.detection import p_values
from fem.mismatch.selection.screening import screened
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog

SHOWN = 4


def linear_line(forward: ForwardModel) -> str:
    """p-value, statistics, and the gain and amounts of the effects that gain most."""
    recorded = [GraspEquations.of(forward, recording) for recording in forward.base.grasps]
    linear = screened(forward, recorded, EFFECTS)
    statistics = detection_statistics(linear, recorded, forward.compliance_ratio)
    best = ", ".join(
        f"{one.effect.spec.name} {one.gain:.1f} nats ({', '.join(f'{x:.3g}' for x in one.amounts)})"
        for one in linear.best[:SHOWN]
    )
    said = " ".join(f"{name} {value:.3f}" for name, value in statistics.items())
    return f"p {p_values(statistics)[0]:.3f}, {said}: {best}"


def lines_of(forward: ForwardModel) -> list[str]:
    """Three lines: what is added, and the linear round with it and without."""
    started = time.process_time()
    added_um = []
    for recording in forward.base.grasps:
        added = withheld_response(forward, recording)
        touching = recording.tracks.episode >= 0
        size = 0.0 if added is None else float(np.sqrt((added[touching] ** 2).mean()))
        added_um.append(f"{1e3 * forward.compliance * size:.2f}")
    seconds = time.process_time() - started
    without = replace(forward, memo=MemoTable())
    for recording in without.base.grasps:
        leave_withheld(without, recording)
    dofs = 3 * len(forward.base.mesh.nodes_mm)
    return [
        f"{dofs} dofs, added {' '.join(added_um)} um ({seconds:.1f} s of CPU)",
        f"with    {linear_line(forward)}",
        f"without {linear_line(without)}",
    ]


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
