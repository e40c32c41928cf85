"""The candidate grasps, each with how far it sets apart what is left."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fem.fem_failure import FemFailure
from fem.mismatch.design.candidate_grasps import CandidateGrasp, candidate_grasps
from fem.mismatch.design.expected_evidence import PairDistance, PairGram, pair_distance, smallest
from fem.mismatch.design.placed_candidate import PlacedCourse, placed_course
from fem.mismatch.design.predictions import Explained, Predicted, candidate_set, predictions
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.selection.decision import CREDIBLE, TEMPERATURE
from fem.parallel_map import parallel_map

ENOUGH = TEMPERATURE * float(np.log(1 / (1 - CREDIBLE)))
"""ln evidence by which one explanation must lead to stand alone: odds of 20 to 1."""


@dataclass(frozen=True, kw_only=True)
class ComparedCandidate:
    """A candidate with its recording, the distance of every pair, and the probability that it decides."""

    candidate: CandidateGrasp
    recording: GraspResponse
    pairs: tuple[PairDistance, ...]
    decides: float

    @property
    def least(self) -> PairDistance:
        """The pair told apart least."""
        return smallest(self.pairs)


def compared_candidates(forward: ForwardModel, explained: Sequence[Explained]) -> list[ComparedCandidate]:
    """The greatest smallest distance first; empty where no explanation can be followed to any candidate.

    `forward`: the plain model of the recordings so far. Candidates out of the jaws' reach are left out.
    """
    courses: list[PlacedCourse] = []
    numbers: dict[tuple[int, float], int | None] = {}
    chosen: list[tuple[CandidateGrasp, int]] = []
    places: list[object] = []
    for candidate in candidate_grasps(forward.base.grasps):
        known = next((k for k, place in enumerate(places) if place is candidate.place), None)
        if known is None:
            known = len(places)
            places.append(candidate.place)
        key = (known, candidate.protocol.depth)
        if key not in numbers:
            try:
                courses.append(placed_course(forward.base, candidate.place, candidate.protocol.depth))
                numbers[key] = len(courses) - 1
            except FemFailure:
                numbers[key] = None
        course = numbers[key]
        if course is not None:
            chosen.append((candidate, course))
    if not chosen:
        return []
    names = {
        explanation.products.columns[j].name for explanation in explained for j in explanation.fit.chosen
    }
    candidates = candidate_set(
        forward,
        courses,
        [(candidate.protocol, course) for candidate, course in chosen],
        names=names,
    )
    with_candidates = candidates.forward
    recordings = with_candidates.base.grasps
    each = [predictions(explanation, candidates) for explanation in explained]

    def compared(k: int) -> ComparedCandidate:
        pairs = _pairs(with_candidates, recordings[k], explained, [predicted[k] for predicted in each])
        return ComparedCandidate(
            candidate=chosen[k][0],
            recording=recordings[k],
            pairs=tuple(pairs),
            decides=min(pair.decides for pair in pairs),
        )

    answered = [k for k in range(len(chosen)) if all(predicted[k].answered for predicted in each)]
    comparisons = parallel_map(compared, answered, workers=forward.workers)
    return sorted(comparisons, key=lambda candidate: -candidate.least.least)


def _pairs(
    forward: ForwardModel,
    recording: GraspResponse,
    explained: Sequence[Explained],
    predicted: Sequence[Predicted],
) -> list[PairDistance]:
    """Of all pairs of explanations on one candidate."""
    equations = GraspEquations.of(forward, recording)
    fields = {id(field): field for prediction in predicted for field in (prediction.mean, *prediction.fields)}
    row = {key: number for number, key in enumerate(fields)}
    plain, weighed = equations.rows(list(fields.values()))
    products = weighed @ plain.T
    products = (products + products.T) / 2

    distances = []
    for i, j in combinations(range(len(explained)), 2):
        difference = np.zeros(len(products))
        difference[row[id(predicted[i].mean)]] += 1
        difference[row[id(predicted[j].mean)]] -= 1
        places, covariances = [], []
        columns = [difference]
        for rival in (predicted[i], predicted[j]):
            sd = np.sqrt(np.maximum(np.diag(rival.covariance), 1e-300))
            covariances.append(rival.covariance / np.outer(sd, sd))
            places.append(np.arange(len(sd)) + len(columns))
            for field, scale in zip(rival.fields, sd, strict=True):
                column = np.zeros(len(products))
                column[row[id(field)]] = scale
                columns.append(column)
        basis = np.stack(columns)
        gram = PairGram(
            products=basis @ products @ basis.T,
            first=places[0],
            second=places[1],
            first_covariance=covariances[0],
            second_covariance=covariances[1],
        )
        first, other = explained[i], explained[j]
        distances.append(
            pair_distance(
                gram,
                names=(first.name, other.name),
                lead=first.gain - other.gain,
                first_share=first.probability / max(first.probability + other.probability, 1e-300),
                enough=ENOUGH,
                rng=np.random.default_rng(0),
            )
        )
    return distances
