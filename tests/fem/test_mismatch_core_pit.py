"""A pit elsewhere, or of another size: against the fruit meshed and solved with it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse_fruit import NU, fruit_mesh
from pinched_case_model import COMPLIANCE, in_full, model_of

from fem.estimation.compliance_fit import rigid_motion
from fem.mismatch.effects import pit_offset, pit_size
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.warm_start import WarmStarts
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved

OFFSET = tuple(spec.name for spec in pit_offset.SPEC.searched)


@cache
def model() -> CaseModel:
    return model_of()


def solved(place: tuple[float, float, float, float]) -> np.ndarray:
    """c(t) of the recording with the pit there, the mesh's nodes moved and everything anew."""
    mesh = with_pit_moved(fruit_mesh(), np.array(place))
    return in_full(model(), UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free"))


def responded(effect, names: tuple[str, ...], values: tuple[float, ...]) -> np.ndarray:
    return effect.respond(model(), dict(zip(names, values, strict=True)), ONE_WAY).unit[0]


def test_pits_of_other_sizes_answer_as_the_fruit_solved_with_them():
    """Exact for the first size that a search asks for, near it read off a curve; else exact."""
    search = replace(model(), warm_starts=WarmStarts())
    plain = model().grasps[0].tracks.unit_displacement
    for scale, tolerance in ((0.78, 1e-6), (0.72, 0.06)):
        (response,) = pit_size.EFFECT.respond(search, {"scale": scale}, ONE_WAY).unit
        expected = solved((0, 0, 0, np.log(scale)))
        assert np.linalg.norm(response - expected) < tolerance * np.linalg.norm(expected - plain)


def test_a_pit_elsewhere_answers_as_the_fruit_solved_with_it():
    response = responded(pit_offset.EFFECT, OFFSET, (1.5, -1.0, 0.5))
    expected = solved((1.5, -1.0, 0.5, 0.0))
    plain = model().grasps[0].tracks.unit_displacement
    assert np.linalg.norm(response - expected) < 1e-6 * np.linalg.norm(expected - plain)


@pytest.mark.parametrize(("effect", "way"), [(pit_offset.EFFECT, 0), (pit_size.EFFECT, 3)])
def test_signatures_are_slopes_of_fruit_solved_with_the_pit_a_little_moved(effect, way):
    step = 0.02 if way == 3 else 0.1
    place = np.zeros(4)
    place[way] = step
    slope = COMPLIANCE * (solved(tuple(place)) - solved(tuple(-place))) / (2 * step)
    (signature,) = effect.signatures(model())
    markers = signature.columns[0].fields[0].markers
    # rigid motions are every frame's own: what is left without them counts
    modes = rigid_motion(model().grasps[0].tracks.place_mm).reshape(-1, 6)

    def strained(field: np.ndarray) -> np.ndarray:
        flat = field.reshape(len(field), -1).T
        return flat - modes @ np.linalg.lstsq(modes, flat, rcond=None)[0]

    off = np.linalg.norm(strained(slope) - strained(markers))
    assert off < 0.02 * np.linalg.norm(strained(markers))


def test_an_amount_of_the_signature_is_where_the_search_starts():
    (signature,) = pit_size.EFFECT.signatures(model())
    assert pit_size.EFFECT.start(model(), signature, np.array([np.log(1.2)])) == {"scale": pytest.approx(1.2)}
    (signature,) = pit_offset.EFFECT.signatures(model())
    start = pit_offset.EFFECT.start(model(), signature, np.array([0.5, -1.0, 9.0]))
    assert list(start.values()) == pytest.approx([0.5, -1.0, 6.0])
