"""The input of the process that grades one fruit."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.batch.cache import ROOMS, stage_key
from pipeline.batch.confirmed_effects import effects_on, keyed
from pipeline.batch.fruits_table import Given, given_of
from pipeline.batch.layout import FruitFolder, FruitResults, Results
from pipeline.batch.named_priors import CATEGORY, reference_prior
from pipeline.batch.opening import Batch, reference_ratio
from pipeline.batch.rig_setting import rig_path
from pipeline.batch.settings import NO_PIT, PitSettings, Settings
from pipeline.batch.unused_files import unused_of_fruit
from pipeline.files.plain_file import printable
from recon.cameras.printed_mat import Mat
from recon.learned.onnx_file import model_files
from recon.pit.priors import PitBody, PitPrior

IN_THE_REPORT_ALONE = {
    "calibration_days", "columns", "cultivar", "grading", "harvest_date", "lot", "measured_on", "notes",
    "operator", "orchard", "packer", "pulp_temperature_C", "reference", "temperature",
}  # fmt: skip
"""Settings that do not change a fruit's own result."""
NOT_IN_THE_KEY: dict[str, Any] = {
    **dict.fromkeys(IN_THE_REPORT_ALONE, True),
    "sensor": {"calibration", "calibrated_on"},
    "mismatch": True,
}
"""Settings left out of a fruit's key; the confirmed effects enter the key separately."""


@dataclass(frozen=True, kw_only=True)
class FruitTask:
    """All input for one fruit's process; its settings have only the confirmed effects of this fruit.

    `category`: its name, even if the settings give a file. `body`: a whole fruit's usual shape and density.
    `batch_fruits`: every fruit_id of the batch, None for a single case. `screen`: whether drupe screens the
    fruit for missing physics.
    """

    fruit_id: str
    folder: FruitFolder
    batch_root: Path
    results: FruitResults
    settings: Settings
    mat: Mat | None
    category: str
    body: PitBody
    prior: PitPrior | None
    given: Given
    key: str
    batch_fruits: frozenset[str] | None = None
    screen: bool = True

    def named_in_batch(self, sentence: str) -> str:
        """The sentence with paths of the batch's files relative to its folder."""
        root = re.escape(printable(str(self.batch_root)))
        return re.sub(rf"(?<![^\s(\"'\[`:=]){root}/", "", sentence)


def fruit_task(batch: Batch, fruit_id: str, results: Results, *, screen: bool = True) -> FruitTask:
    """The task of one fruit of the batch, and the key (hash) of everything its result depends on.

    Its paths are absolute, because the fruit's process works in another folder.
    """
    row = batch.row_of[fruit_id]
    folder = batch.folder.fruit(fruit_id)
    effects = effects_on(batch.settings.mismatch, fruit_id)
    settings = batch.settings.model_copy(update={"mismatch": effects})
    category, body, prior = batch.category, batch.body, batch.prior
    if row.reference:
        # Effects of the flesh of all fruit do not apply to a reference body.
        effects = tuple(effect for effect in effects if effect.fruits is not None or effect.spec.of_the_jaws)
        changed = {
            "mismatch": effects,
            "pit": PitSettings(prior=NO_PIT),
            "poisson_ratio": None,
            "poisson_ratio_sd": None,
        }
        settings = batch.settings.model_copy(update=changed)
        prior = reference_prior(reference_ratio(row, batch.settings))
        category, body = CATEGORY, prior.body
    files = list(folder.input_files())
    if batch.mat is not None:
        files.append(batch.folder.mat)
    if settings.recon.geometry_model is not None:
        files += model_files(batch.folder.root / settings.recon.geometry_model)
    if (rig := rig_path(batch.folder.root, settings)) is not None:
        files.append(rig)
    key = stage_key(
        "fruit",
        files=files,
        settings=[
            settings.model_dump(mode="json", exclude=NOT_IN_THE_KEY),
            keyed(effects),
            row.height_mm,
            *([row.diameters, row.axis, row.pit_share] if folder.without_shape() else []),
            *folder.unused_photos(),
            *[problem.sentence for problem in unused_of_fruit(folder)],
            category,
            repr(body),
            repr(prior),
        ],
        rooms=ROOMS,
    )
    return FruitTask(
        fruit_id=fruit_id,
        folder=FruitFolder(folder.root.absolute()),
        batch_root=batch.folder.root.absolute(),
        results=FruitResults(results.fruit(fruit_id).root.absolute()),
        settings=settings,
        mat=batch.mat,
        category=category,
        body=body,
        prior=prior,
        given=given_of(row),
        key=key,
        batch_fruits=frozenset(batch.row_of),
        screen=screen,
    )
