"""Effects that change the model: Poisson's ratio, the pit's place and size, and those handed to mechanics."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from bare_grasp_model import BARE_MODEL

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.catalogue import SPECS
from pipeline.batch.confirmed_effects import ConfirmedEffect, PitFound, pit_found
from pipeline.batch.layout import FruitResults, Results
from pipeline.batch.settings import PitSettings, Settings
from pipeline.fruit.flesh_effects import (
    MECHANICS,
    catalogue_parameters,
    unused_warnings,
    used,
    with_corrections,
)
from pipeline.fruit.flesh_model import error_budget, poisson_ratio
from pipeline.fruit.fruit_shape import embedded_pit
from pipeline.fruit.repeated_modulus import _shifted
from pipeline.ranking.report_entries import _explained
from pipeline.ranking.report_pictures import MANY_SCENES, fruit_pictures
from recon.surface.mesh_file import write_mesh

NU = ConfirmedEffect(effect="poisson_ratio", parameters={"nu": 0.41}, sd={"nu": 0.007})
OFFSET = ConfirmedEffect(
    effect="pit_offset", parameters={"offset_mm": (1.0, -2.0, 0.5)}, sd={"offset_mm": (0.1, 0.2, 0.1)}
)
SIZE = ConfirmedEffect(effect="pit_size", parameters={"scale": 0.8}, sd={"scale": 0.02})
SKIN = ConfirmedEffect(effect="skin", parameters={"Et_N_per_mm": 2.0}, sd={"Et_N_per_mm": 0.1})
BOX = trimesh.creation.box([2.0, 2.0, 2.0])


def settings(*effects, **rest):
    return Settings(category="nectarine", poisson_ratio=0.45, mismatch=effects, **rest)


def test_a_ratio_that_was_found_comes_before_the_settings():
    assert poisson_ratio(settings(NU), None) == (0.41, 0.007, "found by drupe explain")
    assert poisson_ratio(settings(), None)[:2] == (0.45, 0.0)


def test_a_pit_that_was_found_narrows_the_error_budget():
    task = SimpleNamespace(
        settings=settings(OFFSET, SIZE, pit=PitSettings(offset_sd_mm=0.5, size_sd=0.03)), prior=None
    )
    shape = SimpleNamespace(record=SimpleNamespace(surface_sd_mm=None))
    budget = error_budget(task, shape)
    assert budget.pit_offset_sd_mm == 0.2
    assert budget.pit_size_sd == pytest.approx(0.025)
    assert pit_found(()) == PitFound()
    robots = [SimpleNamespace(pose_sd_mm=sd) for sd in (0.4, 0.7)]
    assert error_budget(task, shape, robots).pose_sd_mm == 0.7
    robots.append(SimpleNamespace(pose_sd_mm=None))
    assert error_budget(task, shape, robots[-1:]).pose_sd_mm == budget.pose_sd_mm == 0.3


def test_a_pit_that_was_found_is_embedded_where_it_was_found(tmp_path):
    write_mesh(tmp_path / "pit.ply", 5.0 * BOX.vertices + [0, 0, 1], BOX.faces)
    folder = SimpleNamespace(pit_ply=tmp_path / "pit.ply")
    shape = SimpleNamespace(vertices=20.0 * BOX.vertices, faces=BOX.faces)
    plain = embedded_pit(SimpleNamespace(folder=folder, settings=settings(), prior=None), shape)
    moved = embedded_pit(SimpleNamespace(folder=folder, settings=settings(OFFSET, SIZE), prior=None), shape)
    assert np.subtract(moved.record.centre_mm, plain.record.centre_mm) == pytest.approx(
        [1.0, -2.0, 0.5], abs=1e-5
    )
    assert moved.record.volume_mm3 == pytest.approx(0.8**3 * plain.record.volume_mm3)
    assert "moved to where it was found" in moved.record.source


def test_what_effects_add_goes_to_the_grasps_that_have_a_model():
    lost = FemFailure(FemProblem.NO_LOAD, "no load")
    models = [BARE_MODEL, lost, replace(BARE_MODEL, displacement_correction=np.ones((3, 2, 3)))]
    first, second, third = with_corrections(models, [np.full((3, 2, 3), 2.0)] * 2)
    assert second is lost
    assert (first.displacement_correction == 2.0).all()
    assert (third.displacement_correction == 3.0).all()


def test_every_effect_that_can_be_confirmed_has_the_parameters_of_its_model():
    values = {"number": 0.4, "pair": (0.1, 0.2), "triple": (0.1, 0.2, 0.3), "pad": "left"}
    for name, spec in SPECS.items():
        parameters = {parameter.name: values[parameter.kind] for parameter in spec.parameters}
        effect = ConfirmedEffect(effect=name, parameters=parameters)
        assert used([effect]) == (effect,)
        if name in MECHANICS:
            wanted = {spec.name for spec in MECHANICS[name].spec.searched}
            assert catalogue_parameters(effect, 0.5).keys() == wanted


def test_a_skin_counts_in_the_stiffness_of_the_flesh_below_it():
    assert catalogue_parameters(SKIN, 0.4) == {"Et_over_E_mm": pytest.approx(5.0)}


def test_a_second_relaxing_arm_is_said_to_be_left_out():
    parameters = {"g": 0.2, "tau_s": 1.0, "g_2": 0.1, "tau_2_s": 9.0}
    arms = ConfirmedEffect(effect="viscoelastic", parameters=parameters)
    assert used([arms, SKIN]) == (SKIN,)
    (warning,) = unused_warnings([arms, SKIN])
    assert warning.startswith("batch.toml confirms viscoelastic with g_2, tau_2_s, which grading cannot")


def test_each_number_is_moved_by_its_own_spread_for_the_error_bar():
    moved = [shifted.vector("offset_mm") for _, shifted in _shifted(OFFSET)]
    assert moved == [(1.1, -2.0, 0.5), (1.0, -1.8, 0.5), (1.0, -2.0, 0.6)]
    ((name, shifted),) = _shifted(SIZE)
    assert (name, shifted.number("scale")) == ("scale", pytest.approx(0.82))


def test_an_answer_of_other_inputs_is_not_the_fruits(tmp_path):
    files, record = FruitResults(tmp_path), SimpleNamespace(key="k1")
    assert _explained(record, files) is None
    said = {"key": "k1", "verdict": ["skin", "slip"], "ranking": [{"effect": "slip"}, {"effect": "skin"}]}
    files.mismatch.write_text(json.dumps(said))
    answer = _explained(record, files)
    assert answer.names == ("slip", "skin")
    assert _explained(SimpleNamespace(key="k2"), files) is None
    files.mismatch.write_text("half a fi")
    assert _explained(record, files) is None


def test_many_fruit_are_not_shown_in_three_dimensions(tmp_path):
    results = Results(tmp_path)
    files = results.fruit("N01")
    files.root.mkdir(parents=True)
    for path, content in ((files.outlines, b"a link"), (files.scene, b"own")):
        path.write_bytes(content)
    for fruits, shown in ((1, b"own"), (MANY_SCENES + 1, b"")):
        assert fruit_pictures(results, files, fruits=fruits).scene == shown
