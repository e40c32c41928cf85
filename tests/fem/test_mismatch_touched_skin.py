"""Markers sit on the skin that they touched, which had been pushed aside: closed forms of a stretch."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from injected_mismatch import injected_case, only_grasp

from fem.estimation.sensitivity import mean_normal
from fem.mismatch.model.plain_model import PlainModel, plain_model
from fem.mismatch.model.touched_skin import with_touched_skin

STRETCH, COMPLIANCE = 0.02, 2.0


@cache
def plain() -> PlainModel:
    return plain_model(only_grasp(injected_case(noise=0.0), 0))


def moving(field) -> PlainModel:
    """The same recording, its skin moved by field(place, normal) times the load, for E = 1 MPa."""
    base = plain()
    recording = base.grasps[0]
    unit = np.zeros_like(recording.tracks.unit_displacement)
    for pad, link in enumerate(recording.links):
        mine = recording.pad_of_marker == pad
        place = recording.tracks.place_mm[mine]
        unit[:, mine] = recording.load[:, None, None] * field(
            place - place.mean(axis=0), mean_normal(link.place.normal)
        )
    return replace(
        base, grasps=(replace(recording, tracks=replace(recording.tracks, unit_displacement=unit)),)
    )


def moved_places(base: PlainModel) -> np.ndarray:
    after = with_touched_skin(base, compliance=COMPLIANCE).grasps[0].case.history.pads
    before = base.grasps[0].case.history.pads
    return np.concatenate([a.surface_mm - b.surface_mm for a, b in zip(after, before, strict=True)])


def test_places_go_back_by_half_the_step_in_which_the_marker_touched():
    base = moving(lambda place, normal: STRETCH * (place - np.outer(place @ normal, normal)))
    recording = base.grasps[0]
    back = moved_places(base)
    episode = np.concatenate([pad.episode[recording.used] for pad in recording.case.history.pads], axis=1)
    first = (episode >= 0).argmax(axis=0)
    late = (episode >= 0).any(axis=0) & (first == first.max())
    assert late.sum() > 3
    k = first.max()
    middle = (recording.load[k - 1] + recording.load[k]) / 2
    for pad, link in enumerate(recording.links):
        markers = late & (recording.pad_of_marker == pad)
        place = recording.tracks.place_mm - recording.tracks.place_mm[recording.pad_of_marker == pad].mean(
            axis=0
        )
        normal = mean_normal(link.place.normal)
        along = place - np.outer(place @ normal, normal)
        got = np.einsum("nx,nx->n", back[markers], along[markers]) / (along[markers] ** 2).sum(axis=1)
        assert got == pytest.approx(-COMPLIANCE * STRETCH * middle, rel=0.15)
        assert np.abs(back[markers] @ normal).max() < 1e-9


def test_a_dent_along_the_normal_moves_no_place():
    dent = moving(lambda place, normal: np.outer(-0.1 * np.exp(-(place**2).sum(axis=1) / 8), normal))
    assert np.abs(moved_places(dent)).max() < 0.02


def test_flesh_that_gives_way_nowhere_leaves_places_as_they_were():
    base = plain()
    after = with_touched_skin(base, compliance=0.0).grasps[0].case.history.pads
    for pad_after, other in zip(after, base.grasps[0].case.history.pads, strict=True):
        assert (pad_after.surface_mm == other.surface_mm).all()
