"""Error of an effect's law: it widens the effect's parameters."""

from dataclasses import replace

import numpy as np
from injected_mismatch import Altered, Recording, injected_case
from pinched_case_model import model_of
from plain_model import screened_effects

from fem.mismatch.effect_spec import EffectSpec
from fem.mismatch.effects import gripper_compliance, skin
from fem.mismatch.evidence.law_error import law_error_columns
from fem.mismatch.procedure import case_model
from fem.mismatch.selection.refinement import refit
from fem.mismatch.signature_variant import ONE_WAY

MM_PER_N = 0.4


def jaws(off: float) -> Altered:
    """Jaws that give way by a share `off` more at the greatest force than in proportion to it."""

    def change(pad: Recording) -> Recording:
        force_N = pad.pushed_N * (1 + off * pad.pushed_N / np.abs(pad.pushed_N).max())
        ahead = MM_PER_N * force_N[:, None] * pad.axes[:, 2]
        return replace(pad, position_mm=pad.position_mm + ahead[:, None], origin_mm=pad.origin_mm + ahead)

    return change


def test_the_columns_scale_with_the_effect_and_each_has_its_own_shape():
    model = model_of()
    columns = [
        law_error_columns(model, skin.EFFECT, skin.EFFECT.respond(model, {"Et_over_E_mm": size}, ONE_WAY))
        for size in (0.5, 0.0)
    ]
    rows = [np.stack([column.fields[0].markers.ravel() for column in some]) for some in columns]
    assert {column.sd for column in columns[0]} == {skin.EFFECT.spec.law_error}
    # of one recording, its own column is the common one
    assert np.linalg.matrix_rank(rows[0]) == len(rows[0]) - 1
    np.testing.assert_allclose(rows[1], 0.0, atol=1e-12 * np.abs(rows[0]).max())


def test_a_law_that_is_off_is_within_its_error(monkeypatch):
    model, _ = case_model(injected_case(jaws(0.15)))
    linear = screened_effects(model, [gripper_compliance.EFFECT])
    again = refit(model, linear, linear.best)
    monkeypatch.setattr(EffectSpec, "law_error", 1e-6)
    exact = refit(model, linear, linear.best)
    off = abs(again.parameters[0]["mm_per_N"] - MM_PER_N)
    assert off < 2 * np.sqrt(again.covariance[0, 0])
    assert off > 2 * np.sqrt(exact.covariance[0, 0])
