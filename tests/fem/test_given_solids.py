"""The finder uses the solids that grading factorised, where they are of the same mesh and Poisson's ratio."""

from dataclasses import replace
from functools import cache

import pytest
from injected_mismatch import injected_case
from plain_model import kept_solid

from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model.plain_model import solids_of
from fem.solid.linear_solid import UnitModulusSolid


@pytest.fixture
def factorised(monkeypatch):
    """What is factorised anew, by mesh and Poisson's ratio; nothing is computed."""
    asked, known = [], solid()

    def factorise(mesh, *, poisson_ratio, support, parts):
        asked.append((mesh, poisson_ratio))
        return known

    monkeypatch.setattr(UnitModulusSolid, "factorise", factorise)
    return asked


@cache
def case() -> MismatchCase:
    return injected_case()


def solid() -> UnitModulusSolid:
    return kept_solid(case().mesh, case().poisson_ratio, "free")


def test_a_given_solid_is_taken_with_all_the_skin_as_contact(factorised):
    free_solid = solids_of(case(), {"free": solid()})["free"]
    assert factorised == []
    assert free_solid.factor is solid().factor
    assert sorted(free_solid.contact_nodes.tolist()) == sorted(case().mesh.outer_nodes.tolist())


def test_one_of_another_poisson_ratio_or_mesh_is_not_taken(factorised):
    solids_of(case(), {"free": replace(solid(), poisson_ratio=0.4)})
    solids_of(case(), {"free": replace(solid(), mesh=replace(case().mesh))})
    solids_of(case(), {})
    assert factorised == [(case().mesh, case().poisson_ratio)] * 3
