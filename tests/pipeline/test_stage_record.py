"""What a stage keeps comes back as it was, and what is none of it is refused."""

import numpy as np
import pytest
from jaxtyping import Float, Int
from pydantic import ValidationError

from fem.estimation.grasp_model import GraspModel
from fem.estimation.sensitivity import Sensitivity
from fem.fem_failure import FemFailure, FemProblem
from pipeline.batch.cache import StageRecord
from pipeline.batch.records import MeshRecord
from pipeline.fruit.elasticity import KeptModels
from recon.checks.quality import ReconQuality


class Part(StageRecord):
    points_mm: Float[np.ndarray, "n 3"]
    heights_mm: Float[np.ndarray, " n"] | None


class Whole(StageRecord):
    name: str
    parts: tuple[Part, ...]
    share: float
    faces: Int[np.ndarray, "m 3"]


def whole():
    rng = np.random.default_rng(1)
    parts = tuple(
        Part(points_mm=rng.normal(size=(n, 3)), heights_mm=h) for n, h in ((4, None), (2, np.ones(2)))
    )
    return Whole(name="Kirsche ✓", parts=parts, share=1 / 3, faces=np.array([[0, 1, 2]]))


def test_a_record_comes_back_as_it_was_with_records_and_arrays_inside():
    made = whole()
    text, arrays = made.stored()
    restored = Whole.restored(text, arrays)
    assert (restored.name, restored.share) == (made.name, made.share)
    for part, other in zip(restored.parts, made.parts, strict=True):
        np.testing.assert_array_equal(part.points_mm, other.points_mm)
    assert restored.parts[0].heights_mm is None
    np.testing.assert_array_equal(restored.parts[1].heights_mm, np.ones(2))
    assert restored.faces.dtype == made.faces.dtype


@pytest.mark.parametrize(
    "wrong",
    [
        {"points_mm": np.zeros((2, 2)), "heights_mm": None},
        {"points_mm": np.zeros((2, 3), dtype=int), "heights_mm": None},
        {"points_mm": np.zeros((2, 3)), "heights_mm": np.zeros(3)},
        {"points_mm": np.zeros((2, 3))},
        {"points_mm": np.zeros((2, 3)), "heights_mm": None, "more": 1},
        {"points_mm": [[0.0, 0.0, 0.0]], "heights_mm": None},
    ],
)
def test_another_shape_or_type_a_field_too_few_or_too_many_is_refused(wrong):
    with pytest.raises(ValidationError):
        Part(**wrong)


def test_a_record_whose_array_is_missing_is_none():
    text, arrays = whole().stored()
    with pytest.raises(ValueError, match="missing"):
        Whole.restored(text, {name: a for name, a in arrays.items() if name != "faces"})


def grasp_model(rng, markers=3):
    half = rng.normal(size=(3 * markers, 3 * markers))
    return GraspModel(
        place_mm=rng.normal(size=(markers, 3)),
        normal=rng.normal(size=(markers, 3)),
        compliance=half + half.T,
        sensitivity=Sensitivity(causes=("pit x", "left across"), values=rng.normal(size=(2, 4, markers, 3))),
        discretisation=0.01,
        fruit_moves=True,
        displacement_correction=rng.normal(size=(5, markers, 3)),
    )


def test_grasp_models_come_back_to_single_precision_and_failures_with_their_words():
    given = [grasp_model(np.random.default_rng(2)), FemFailure(FemProblem.OFF_SURFACE, "off by 3 mm")]
    model, failed = KeptModels.of(given).unpacked()
    assert isinstance(model, GraspModel)
    for name in ("place_mm", "normal", "compliance", "displacement_correction"):
        np.testing.assert_allclose(getattr(model, name), getattr(given[0], name), rtol=1e-6)
    np.testing.assert_allclose(model.sensitivity.values, given[0].sensitivity.values, rtol=1e-6)
    assert model.sensitivity.causes == given[0].sensitivity.causes
    assert (model.discretisation, model.fruit_moves) == (0.01, True)
    assert isinstance(failed, FemFailure)
    assert (failed.problem, failed.detail) == (FemProblem.OFF_SURFACE, "off by 3 mm")


def test_a_grasp_model_whose_normals_are_of_other_markers_is_refused():
    kept = KeptModels.of([grasp_model(np.random.default_rng(3))])
    text, arrays = kept.stored()
    arrays["models.0.normal"] = arrays["models.0.normal"][:-1]
    with pytest.raises(ValidationError):
        KeptModels.restored(text, arrays)


def test_of_a_meshs_quality_only_what_is_known_is_written():
    record = MeshRecord(
        source="photos", vertices=4, faces=4, volume_mm3=1.0, height_mm=1.0, box_mm=(1.0, 1.0, 1.0),
        quality=ReconQuality().known(),
    )  # fmt: skip
    known = {"views_given": 0, "views_used": 0, "relief_share": 0.0, "flipped_views": 0}
    assert record.model_dump()["quality"] == known
    assert MeshRecord.model_validate_json(record.model_dump_json()) == record
