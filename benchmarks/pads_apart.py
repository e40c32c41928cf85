"""By how much the two pads of a recording differ in 1/E beyond noise and what pit and places may be off by.

    python benchmarks/pads_apart.py DIR [DIR ...] [--half even|odd|all]

DIR is a folder of sound fruit or holds such folders (benchmarks/plain_modulus.py). Of each recording: the
difference of the pads' own 1/E over their mean, its standard deviation by noise and by the priors of pit,
places, surface and scales (fem.estimation.information.pad_compliances). In the end the factor on the
variance of noise that makes all differences most likely: BETWEEN_PADS of fem.estimation.information.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from plain_modulus import case_of, folders_in
from threadpoolctl import threadpool_limits

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.frame_thinning import loaded_frames
from fem.estimation.grasp_model import GraspModel
from fem.estimation.information import FORCE_SCALE, PadCompliances, pad_compliances
from fem.estimation.unit_response import marker_tracks
from fem.fem_failure import FemFailure
from fem.grasp_history import GraspHistory
from pipeline.batch.outcome import FruitEnded
from pipeline.fruit.elasticity import prepared_histories, responses
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog
from tactile.tactile_failure import TactileFailure

FACTORS = np.linspace(0.5, 10, 96)
"""Factors on the variance that are tried."""


def recordings(folder: Path) -> Iterator[tuple[GraspHistory, GraspModel, ErrorBudget]]:
    """The prepared recordings of a fruit and their models, about the prior's pit."""
    with tempfile.TemporaryDirectory() as work, threadpool_limits(1):
        case, _ = case_of(folder, Path(work))
        fruit = grasped_fruit(case.task, StageLog(lambda _: None))
        prepared, histories = prepared_histories(fruit.placed)
        models = responses(
            case.task,
            "response-0",
            fruit.placed,
            prepared,
            fruit.mesh,
            poisson_ratio=fruit.poisson_ratio,
            budget=fruit.budget,
        )
        for history, model in zip(histories, models, strict=True):
            if isinstance(model, GraspModel):
                yield history, model, fruit.budget


def apart(
    pads: PadCompliances, history: GraspHistory, budget: ErrorBudget
) -> tuple[float, float, float] | None:
    """Difference of two pads over their mean, and its variances by noise and by priors; None for one pad."""
    if len(pads.values) != 2:
        return None
    mean = pads.values.mean()
    prior_sd = [
        budget.force_scale_sd if cause == FORCE_SCALE else budget.sd_of(cause, history=history)
        for cause in pads.causes
    ]
    noise = np.linalg.inv(pads.weight) / mean**2
    priors = (pads.slopes * prior_sd) @ (pads.slopes * prior_sd).T
    way = np.array([1.0, -1.0])
    return float(way @ pads.values / mean), float(way @ noise @ way), float(way @ priors @ way)


def main() -> None:
    """Prints a line per recording, and the factor in the end."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("paths", type=Path, nargs="+")
    parser.add_argument("--half", choices=("even", "odd", "all"), default="all")
    arguments = parser.parse_args()
    found = []
    for folder in folders_in(arguments.paths, arguments.half):
        try:
            for history, model, budget in recordings(folder):
                tracks, force_N = marker_tracks(history, model, loaded_frames(history))
                one = apart(
                    pad_compliances(tracks, model, force_N, history=history, scale_sd=budget.gel_scale_sd),
                    history,
                    budget,
                )
                if one is not None:
                    found.append(one)
                    off, noise, priors = 100 * one[0], 100 * one[1] ** 0.5, 100 * one[2] ** 0.5
                    print(f"{folder.name:12s} {off:+6.1f} %  noise {noise:.1f} %  priors {priors:.1f} %")
        except (FemFailure, FruitEnded, TactileFailure) as failure:
            print(f"{folder.name:12s} {failure}", flush=True)
    if not found:
        raise SystemExit("no recording of two pads with a modulus each")
    off, noise, priors = np.array(found).T
    variance = FACTORS[:, None] * noise + priors
    likelihood = -0.5 * (np.log(variance) + off**2 / variance).sum(axis=1)
    best = int(likelihood.argmax())
    print(
        f"{len(found)} recordings: variance of noise times {FACTORS[best]:.1f}, "
        f"ln likelihood {likelihood[best] - np.interp(1.0, FACTORS, likelihood):.1f} above that of 1"
    )


if __name__ == "__main__":
    main()
