"""What an explanation predicts of candidate recordings, and how uncertain the recordings so far leave that.

    y = s (1 + a_0) c_theta + shift_theta + sum_k a_k phi_k,      a ~ N(found, C)

c_theta, shift_theta: the effects' response at the parameters found; phi: their slopes and the nuisances that
all recordings share. Laws that know no time depend on the course of the forces alone: they are solved for
once at each place and depth, on two cycles, and read off there by every protocol.
"""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from fem.estimation.sensitivity import inner_forces
from fem.fem_failure import FemFailure
from fem.mismatch.design.candidate_grasps import TWICE, PlaceKind, Protocol
from fem.mismatch.design.placed_candidate import PlacedCourse, candidate_recording, frames_of
from fem.mismatch.effect import Effect, Response
from fem.mismatch.evidence.equation_cache import STICK_KEY, gels_stick
from fem.mismatch.evidence.large_deformation import LARGE_DEFORMATION, leave_large_deformation
from fem.mismatch.evidence.linear_evidence import Fit, GramMatrix
from fem.mismatch.evidence.nuisances import common_nuisances
from fem.mismatch.evidence.withheld_response import leave_withheld
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel, MemoTable
from fem.mismatch.model.inner_changes import store_inner_changes
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.pads import slid_response
from fem.mismatch.model.warm_start import WarmStarts
from fem.mismatch.response_changes import slope_fields, superposed
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.signature_variant import Variant

PATH_FRAMES_SHARE = 0.2
"""Of the frames on which laws with a history are followed in a case, so many of a few candidates at
once: they load and unload along one course. Set by hand, to bound the time."""


@dataclass(frozen=True, kw_only=True)
class Explained:
    """One of the explanations that are left: its effects refitted, or none of them (`refit` None).

    `probability` and `gain` (ln evidence): of it so far. `fit`, `products`: of the recordings so far.
    """

    name: str
    probability: float
    gain: float
    fit: Fit
    products: GramMatrix
    refit: Refit | None


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Of one candidate: the mean, the fields of uncertain amounts and their covariance."""

    mean: ObservationDelta
    fields: tuple[ObservationDelta, ...]
    covariance: Float[np.ndarray, "k k"]

    @property
    def answered(self) -> bool:
        """Whether the laws have an answer there."""
        known = [delta.markers for delta in (self.mean, *self.fields) if delta.markers is not None]
        return all(bool(np.isfinite(markers).all()) for markers in known)


@dataclass(frozen=True, kw_only=True)
class CandidateSet:
    """The plain model with the candidates in the recordings' place, and with the paths that they share.

    `paths`: two cycles at each place and depth, of `courses`; `of_course`: which of them each candidate
    follows, `rows`: at which frames. `nuisances`: columns by name, of the candidates. `known`: the recordings
    so far.
    """

    forward: ForwardModel
    paths: ForwardModel
    courses: tuple[PlacedCourse, ...]
    of_course: tuple[int, ...]
    rows: tuple[Int[np.ndarray, " _f"], ...]
    nuisances: Mapping[str, Sequence[Regressor]]
    known: tuple[GraspResponse, ...]

    def read(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Fields over the paths' frames, at those of every candidate."""
        return [values[course][row] for course, row in zip(self.of_course, self.rows, strict=True)]


def with_grasps(forward: ForwardModel, grasps: Sequence[GraspResponse], memo: MemoTable) -> ForwardModel:
    """The same model with other recordings; whether gels stick is known from the fruit's own."""
    sticky = gels_stick(forward)
    memo.memoised(STICK_KEY, lambda: sticky)
    return replace(
        forward,
        base=replace(forward.base, grasps=tuple(grasps)),
        graded=(),
        memo=memo,
        warm_starts=WarmStarts(),
        path_share=PATH_FRAMES_SHARE,
    )


def candidate_set(
    forward: ForwardModel,
    courses: Sequence[PlacedCourse],
    chosen: Sequence[tuple[Protocol, int]],
    *,
    names: Collection[str],
) -> CandidateSet:
    """Candidates by protocol and number of their course. `names`: of the nuisances that matter."""

    def recorded(course: int, protocol: Protocol, name: str) -> GraspResponse:
        rng = np.random.default_rng(course)
        return candidate_recording(
            courses[course], protocol, name=name, compliance=forward.compliance, rng=rng
        )

    paths = with_grasps(forward, [recorded(k, TWICE, f"path {k}") for k in range(len(courses))], MemoTable())
    candidates = with_grasps(
        forward,
        [recorded(k, protocol, f"candidate {n}") for n, (protocol, k) in enumerate(chosen)],
        MemoTable(),
    )
    keys = [frames_of(course.course, TWICE).keys for course in courses]
    bare = CandidateSet(
        forward=candidates,
        paths=paths,
        courses=tuple(courses),
        of_course=tuple(k for _, k in chosen),
        rows=tuple(
            np.array([keys[k].index(key) for key in frames_of(courses[k].course, protocol).keys])
            for protocol, k in chosen
        ),
        nuisances={},
        known=forward.base.grasps,
    )
    _store_path_nuisances(bare)
    return replace(bare, nuisances=_nuisance_columns(bare, names))


def _store_path_nuisances(candidates: CandidateSet) -> None:
    """What pit, Poisson's ratio and pads' places change, solved for on all paths at once and read off there.

    Of the leading pattern alone where pads are slid; without waves of the surface, of which each recording
    may have its own in any case (fem.mismatch.evidence.nuisances).
    """
    paths = candidates.paths
    causes, moved = _inner_changes(paths)
    for k, recording in enumerate(paths.base.grasps):
        leave_withheld(paths, recording)
        changes = {cause: recording.over_time(field[k]) for cause, field in zip(causes, moved, strict=True)}
        store_inner_changes(paths, recording, changes)
    slid = []
    for recording in paths.base.grasps:
        leading = replace(
            recording,
            patterns=recording.patterns[:1],
            shares=recording.shares[:, :1],
            moved=recording.moved[:1],
            response=recording.response[:1],
        )
        slid.append(np.stack([slid_response(paths, leading, pad) for pad in range(len(recording.links))]))
    for recording, course, row in zip(
        candidates.forward.base.grasps, candidates.of_course, candidates.rows, strict=True
    ):
        store_inner_changes(candidates.forward, recording, {})
        there = slid[course][:, :, row]
        candidates.forward.memoised(("slid", recording.case.name), partial(np.asarray, there))


def _inner_changes(paths: ForwardModel) -> tuple[list[str], list[list[Float[np.ndarray, "_r _n 3"]]]]:
    """dc/dp by cause, path and pattern."""
    grasps = paths.base.grasps
    causes: list[str] = []
    loads: list[np.ndarray] = []
    for recording in grasps:
        causes, forces = inner_forces(paths.base.solid_of(recording), recording.moved, [], with_surface=False)
        loads.append(forces.reshape(-1, *forces.shape[2:]))
    moved = paths.base.displacements(loads)
    changes: list[list[np.ndarray]] = [[] for _ in causes]
    for recording, displacement in zip(grasps, moved, strict=True):
        on_skin = displacement[:, paths.base.solid_of(recording).contact_nodes]
        by_cause = recording.at_markers(on_skin).reshape(len(causes), len(recording.moved), -1, 3)
        for place, field in zip(changes, by_cause, strict=True):
            place.append(field)
    return causes, changes


def _nuisance_columns(candidates: CandidateSet, names: Collection[str]) -> dict[str, list[Regressor]]:
    """Columns of the nuisances that all recordings share, those of these names, of the candidates.

    Large deformation is left out where flesh is too soft for it.
    """
    paths = candidates.paths
    if LARGE_DEFORMATION not in names:
        leave_large_deformation(paths)
    columns: dict[str, list[Regressor]] = {}
    for column in common_nuisances(paths):
        fields = [
            None if whole is None else _at_rows(whole, row)
            for whole, row in (
                (column.fields[course], row)
                for course, row in zip(candidates.of_course, candidates.rows, strict=True)
            )
        ]
        columns.setdefault(column.name, []).append(replace(column, fields=fields))
    return columns


def _at_rows(field: ObservationDelta, row: Int[np.ndarray, " f"]) -> ObservationDelta:
    return ObservationDelta(
        markers=None if field.markers is None else field.markers[row],
        balance=None if field.balance is None else field.balance[row],
        rest=field.rest,
    )


def predictions(explained: Explained, candidates: CandidateSet) -> list[Predicted]:
    """Of every candidate; the mean is not finite where a law has no answer there."""
    again, forward = explained.refit, candidates.forward
    at = forward if again is None else replace(forward, compliance=again.forward.compliance)
    grasps = forward.base.grasps
    if again is None:
        here, ahead = Response(unit=[grasp.tracks.unit_displacement for grasp in grasps]), []
    else:
        here = _responses(again, again.parameters, at, candidates)
        ahead = [_responses(again, values, at, candidates) for values in _ahead(again)]
    steps = [] if again is None else [step for step, _ in again.ahead]
    slopes = [slope_fields(at, here, far, step) for far, step in zip(ahead, steps, strict=True)]
    amounts, covariance = explained.fit.amounts, explained.fit.covariance
    predicted = []
    chosen = [explained.products.columns[j] for j in explained.fit.chosen]
    for k in range(len(grasps)):
        known: list[tuple[int, ObservationDelta, float]] = []
        plain = ObservationDelta(markers=at.compliance * here.unit[k])
        known.append((0, plain, 1.0 + float(amounts[0])))
        met: dict[str, int] = {}
        for place, (regressor, amount) in enumerate(zip(chosen, amounts, strict=True)):
            if place == 0 or (again is not None and place >= len(chosen) - len(slopes)):
                continue
            number = met.get(regressor.name, 0)
            met[regressor.name] = number + 1
            column = next(iter(candidates.nuisances.get(regressor.name, [])[number : number + 1]), None)
            field = None if column is None else column.fields[k]
            if column is not None and field is not None:
                known.append((place, field, regressor.mean + float(amount)))
        for number, slope in enumerate(slopes):
            place = len(chosen) - len(slopes) + number
            known.append((place, slope[k], float(amounts[place])))
        mean = _sum([(field, amount) for _, field, amount in known])
        shift = None if here.shift_mm is None else here.shift_mm[k]
        mean = _sum(
            [
                (mean, 1.0),
                (
                    ObservationDelta(
                        markers=shift,
                        balance=None if here.balance is None else here.balance[k],
                        rest=None if here.rest is None else here.rest[k],
                    ),
                    1.0,
                ),
            ]
        )
        places = [place for place, _, _ in known]
        predicted.append(
            Predicted(
                mean=mean,
                fields=tuple(field for _, field, _ in known),
                covariance=covariance[np.ix_(places, places)],
            )
        )
    return predicted


def _ahead(again: Refit) -> list[tuple[dict[str, float], ...]]:
    """The parameters a step ahead, one after the other, as in the refit's own slopes."""
    parameters_ahead, steps = [], iter(again.ahead)
    for number, effect in enumerate(again.effects):
        for spec in effect.spec.searched:
            step, _ = next(steps)
            values = [dict(parameters) for parameters in again.parameters]
            old = values[number][spec.name]
            values[number][spec.name] = old * float(np.exp(step)) if spec.log else old + step
            parameters_ahead.append(tuple(values))
    return parameters_ahead


def _responses(
    again: Refit, parameters: Sequence[Mapping[str, float]], at: ForwardModel, candidates: CandidateSet
) -> Response:
    """Of all effects of an explanation together; NaN where a law has no answer."""
    each = [
        response_at_candidates(effect, effect_parameters, variant, at, candidates)
        for effect, effect_parameters, variant in zip(again.effects, parameters, again.variants, strict=True)
    ]
    return each[0] if len(each) == 1 else superposed(at, each)


def response_at_candidates(
    effect: Effect,
    parameters: Mapping[str, float],
    variant: Variant,
    at: ForwardModel,
    candidates: CandidateSet,
) -> Response:
    """One effect's: protocol by protocol where it knows time, else once for each place and depth."""
    if effect.spec.knows_time:
        return effect.respond(at, parameters, variant)
    paths = replace(candidates.paths, compliance=at.compliance)
    parts: list[Response | None] = [None] * len(candidates.courses)
    for courses in _together(effect, candidates):
        model = _alone(paths, courses, candidates if effect.spec.remembers_grasps else None)
        with suppress(FemFailure):
            response = effect.respond(model, parameters, variant)
            first = len(model.base.grasps) - len(courses)
            for number, course in enumerate(courses):
                parts[course] = _of_one(response, first + number)
    whole = [
        Response(unit=[np.full_like(recording.tracks.unit_displacement, np.nan)]) if part is None else part
        for part, recording in zip(parts, paths.base.grasps, strict=True)
    ]
    shifts = [part.shift_mm for part in whole if part.shift_mm is not None]
    balances = [part.balance for part in whole if part.balance is not None]
    rests = [part.rest for part in whole if part.rest is not None]
    all_shift, all_balance = len(shifts) == len(whole), len(balances) == len(whole)
    return Response(
        unit=candidates.read([part.unit[0] for part in whole]),
        shift_mm=candidates.read([shift[0] for shift in shifts]) if all_shift else None,
        balance=candidates.read([balance[0] for balance in balances]) if all_balance else None,
        rest=[rests[k][0] for k in candidates.of_course] if len(rests) == len(whole) else None,
    )


def _together(effect: Effect, candidates: CandidateSet) -> list[list[int]]:
    """Which courses are solved for at once: those of one depth; each alone where laws remember, and then only
    those as deep as before on the spots of one recording, turned and across, to bound the time.
    """
    if effect.spec.remembers_grasps:
        first = candidates.courses[0].place.source
        near = (PlaceKind.SAME, PlaceKind.TURNED, PlaceKind.ACROSS)
        return [
            [k]
            for k, course in enumerate(candidates.courses)
            if course.depth == 1.0 and course.place.kind in near and course.place.source == first
        ]
    depths = [course.depth for course in candidates.courses]
    return [
        [k for k, depth in enumerate(depths) if depth == shared_depth]
        for shared_depth in dict.fromkeys(depths)
    ]


def _alone(paths: ForwardModel, courses: Sequence[int], remembered: CandidateSet | None) -> ForwardModel:
    """These paths alone; where laws remember, after the recording there if flesh has been pressed before."""
    before: list[GraspResponse] = []
    if remembered is not None:
        place = remembered.courses[courses[0]].place
        before = [remembered.known[place.source]] if place.on_pressed_flesh else []
    key = ("alone", tuple(courses), bool(before))
    memo, starts = paths.memoised(key, lambda: (MemoTable(), WarmStarts()))
    model = with_grasps(paths, [*before, *(paths.base.grasps[k] for k in courses)], memo)
    return replace(model, warm_starts=starts)


def _of_one(response: Response, k: int) -> Response:
    """One recording's part of a response."""
    return Response(
        unit=[response.unit[k]],
        shift_mm=None if response.shift_mm is None else [response.shift_mm[k]],
        balance=None if response.balance is None else [response.balance[k]],
        rest=None if response.rest is None else [response.rest[k]],
    )


def _sum(parts: Sequence[tuple[ObservationDelta, float]]) -> ObservationDelta:
    """Channel by channel; a channel that none of them has is None."""

    def total(values: list[tuple[np.ndarray | None, float]]) -> np.ndarray | None:
        known = [amount * value for value, amount in values if value is not None]
        return np.asarray(sum(known)) if known else None

    return ObservationDelta(
        markers=total([(field.markers, amount) for field, amount in parts]),
        balance=total([(field.balance, amount) for field, amount in parts]),
        rest=total([(field.rest, amount) for field, amount in parts]),
    )
