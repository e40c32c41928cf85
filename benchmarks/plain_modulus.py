"""E without an effect over the truth: as `drupe grade` infers it, and by the plain model of `drupe explain`.

    python benchmarks/plain_modulus.py DIR [DIR ...] [--half even|odd|all]

DIR is a folder of fruit or holds such folders: `fruit.ply`, `grasp-*.h5` and `truth.json`, or an
`answers.json` beside them; a case with its `case.toml`, or sound fruit of a bank (benchmarks/field_bank.py).
The plain model's E is the mean of its recordings' own fits, with the markers where registration puts them;
in brackets where they touched (fem.mismatch.model.touched_skin).
"""

import tempfile
import time
from pathlib import Path

import numpy as np
from field_fruit import Fruit, fruits_in
from field_mistakes import as_batch
from script import Half, run
from threadpoolctl import threadpool_limits

from fem.fem_failure import FemFailure
from fem.mismatch.model.plain_model import PlainModel, plain_model
from fem.mismatch.model.touched_skin import with_touched_skin
from fem.mismatch.procedure import plain_fits
from pipeline.batch.outcome import FruitEnded
from pipeline.diagnosis.diagnosed_case import Case, open_case
from pipeline.diagnosis.diagnosis import graded_case, mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog
from tactile.tactile_failure import TactileFailure


def case_of(folder: Path, fruit: Fruit, work: Path) -> Case:
    """The fruit as something to explain."""
    if (folder / "case.toml").is_file():
        return open_case(folder, fruit_id=None, work=work / "stages", out=None)
    batch = as_batch(fruit, work / "batch")
    return open_case(batch, fruit_id="F", work=work / "stages", out=work / "out")


def mean_E_MPa(base: PlainModel) -> float:
    """Over all recordings, in the logarithm."""
    return float(np.exp(-np.mean([np.log(fit.compliance) for fit in plain_fits(base)])))


def main(paths: list[Path], half: Half = "all") -> None:
    """Prints a line per fruit, and root mean squares in the end."""
    errors: list[tuple[float, float, float]] = []
    beyond: list[float] = []
    for folder, drawn in fruits_in(paths, half).items():
        with tempfile.TemporaryDirectory() as work, threadpool_limits(1):
            try:
                case, true = case_of(folder, drawn, Path(work)), drawn.E_MPa
                fruit = grasped_fruit(case.task, StageLog(lambda _: None))
                began = time.process_time()
                graded = graded_case(case, fruit)[0].modulus
                took_s = time.process_time() - began
                base = plain_model(mismatch_case(case, fruit))
            except (FemFailure, FruitEnded, TactileFailure) as failure:
                print(f"{folder.name:12s} {failure}", flush=True)
                continue
            registered = mean_E_MPa(base)
            moved_mm = [recording.tracks.unit_displacement / registered for recording in base.grasps]
            touched = mean_E_MPa(with_touched_skin(base, moved_mm))
        errors.append(
            (100 * (graded.value / true - 1), 100 * (registered / true - 1), 100 * (touched / true - 1))
        )
        beyond.append((graded.value - true) / graded.sd)
        of_grade, plain, shifted = errors[-1]
        print(
            f"{folder.name:12s} {true:.3f} MPa  {len(base.grasps)} recordings  grade {of_grade:+.2f} % "
            f"({beyond[-1]:+.1f} sd)  explain {plain:+.2f} % ({shifted:+.2f} %)  {took_s:.0f} s",
            flush=True,
        )
    if errors:
        roots = np.sqrt(np.mean(np.square(errors), axis=0))
        means = np.mean(errors, axis=0)
        print(f"{len(errors)} fruit, root mean square and mean of grade {roots[0]:.2f}, {means[0]:+.2f} %;")
        print(f"explain {roots[1]:.2f}, {means[1]:+.2f} % ({roots[2]:.2f}, {means[2]:+.2f} %);")
        print(f"grade's error over its own standard deviation: {np.sqrt(np.mean(np.square(beyond))):.2f}")


if __name__ == "__main__":
    run(main)
