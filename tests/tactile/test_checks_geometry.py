"""Where markers lie and what they touch: meshes turned and moved, lattices with holes, a slab's own law."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from recording_mistakes import findings, slab_pad

from tactile.checks.finding import FindingKind
from tactile.checks.footprint import Footprint, better_otherwise
from tactile.checks.gel_law import MOST_FOR_SLAB, displacement_of
from tactile.checks.lattice import missing_sites
from tactile.checks.of_recording import QUARTERS
from tactile.checks.pressing import pressing_of
from tactile.checks.relation import relation_of
from tactile.checks.relation_findings import relation_findings
from tactile.checks.units import FORCE, unit_like


def test_pads_exchanged_and_a_mesh_turned_are_named_where_the_sides_of_the_fruit_differ():
    """On prints by the numbers of a fruit whose sides differ: the left's skin leans, the right's does not."""

    def prints(left, right):
        return [
            Footprint(
                name=name, ahead_mm=0.0, ahead_sd_mm=0.1, middle_mm=30.0 * np.array(t), tilt=np.array(t)
            )
            for name, t in (("left", left), ("right", right))
        ]

    level, leaning = [0.004, -0.006], [0.03, 0.02]
    off, fits = prints(leaning, leaning), prints(level, level)
    found = better_otherwise(off, [(FindingKind.PADS_EXCHANGED, fits)], surface_sd_mm=0.0)
    assert found.kind is FindingKind.PADS_EXCHANGED
    assert "with the pads exchanged: left and right are swapped" in found.sentence
    turned = better_otherwise(
        off, [(FindingKind.PADS_EXCHANGED, off), (FindingKind.MESH_TURNED, fits)], surface_sd_mm=0.0
    )
    assert turned.kind is FindingKind.MESH_TURNED
    for others in (
        [],
        [(FindingKind.PADS_EXCHANGED, off)],
        [(FindingKind.PADS_EXCHANGED, prints(level, [np.nan] * 2))],
    ):
        assert better_otherwise(off, others, surface_sd_mm=0.0) is None
    assert better_otherwise(fits, [(FindingKind.PADS_EXCHANGED, fits)], surface_sd_mm=0.0) is None
    assert better_otherwise(off, [(FindingKind.PADS_EXCHANGED, fits)], surface_sd_mm=0.5) is None


@pytest.mark.parametrize("turn", QUARTERS[:4])
def test_a_mesh_that_lies_on_its_side_is_named(nectarine_grasp, turn):
    recording, (vertices, faces) = nectarine_grasp
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    (found,) = findings(recording, (middle + (vertices - middle) @ turn, faces))
    assert found.kind is FindingKind.MESH_TURNED
    assert "rotated by 90 degrees" in found.sentence


def test_a_mesh_moved_along_the_pads_is_said(nectarine_grasp):
    recording, (vertices, faces) = nectarine_grasp
    aside = recording.pads[0].pose[0, :3, 0]
    found = findings(recording, (vertices + 3.0 * aside, faces))
    assert found
    assert "middle of the" in found[0].sentence
    assert not found[0].refused


def test_missing_sites_are_those_left_out_and_no_others():
    line = np.arange(12.0)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    assert len(missing_sites(grid)) == 0
    out = (np.abs(grid - [5, 6]) < 1.5).all(axis=1)
    sites = missing_sites(grid[~out])
    assert sorted(map(tuple, np.round(sites).tolist())) == sorted(map(tuple, grid[out].tolist()))
    hexagonal = grid @ np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    assert len(missing_sites(hexagonal)) == 0
    assert len(missing_sites(np.delete(hexagonal, 70, axis=0))) == 1


def test_a_hole_of_eight_by_eight_markers_is_found_whole():
    line = np.arange(20.0)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    out = np.abs(grid - 9.5).max(axis=1) < 4.0
    assert out.sum() == 64
    assert sorted(map(tuple, np.round(missing_sites(grid[~out])).tolist())) == sorted(
        map(tuple, grid[out].tolist())
    )


def test_markers_in_no_grid_miss_none():
    scattered = np.random.default_rng(0).uniform(0, 20, (300, 2))
    assert len(missing_sites(scattered)) == 0


def test_a_factor_is_a_unit_only_near_it():
    assert unit_like(102.0, FORCE) == "grams"
    assert unit_like(2.0, FORCE) is None
    assert unit_like(-1.0, FORCE) is None


@cache
def test_a_slabs_forces_follow_its_own_law_and_not_that_of_springs():
    pad = slab_pad()
    by_slab = relation_of(pressing_of(pad))
    by_springs = relation_of(pressing_of(replace(pad, gel_E_MPa=None)))
    assert by_slab.gain == pytest.approx(1.0, abs=0.03)
    assert by_slab.over_markers > 0.95
    assert by_springs.gain < 0.6


def test_a_slab_with_more_markers_than_its_law_is_computed_for_is_not_judged_by_that_of_springs(monkeypatch):
    side = int(np.ceil(np.sqrt(MOST_FOR_SLAB + 1)))
    line = 0.7 * np.arange(float(side))
    flat = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    pad = slab_pad()
    force_N = np.ones((len(pad.pose), len(flat), 3))
    rest_mm = np.column_stack([flat, np.zeros(len(flat))])
    many = replace(pad, rest_mm=rest_mm, force_N=force_N, displacement_mm=force_N)
    assert displacement_of(many, force_N) is None
    assert displacement_of(replace(many, gel_E_MPa=None), force_N) is not None
    monkeypatch.setattr("tactile.checks.gel_law.MOST_FOR_SLAB", len(pad.rest_mm) - 1)
    assert relation_of(pressing_of(pad)) is None
    springs = replace(pad, gel_E_MPa=None)
    assert relation_findings([pressing_of(springs)], closing_mm=[1.0], E_range_MPa=None)[0].refused
    assert relation_findings([pressing_of(pad)], closing_mm=[1.0], E_range_MPa=None) == []
