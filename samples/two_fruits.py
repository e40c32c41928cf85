"""The tiny batch: one fruit that can be graded beside one that cannot, for it was photographed only twice."""

from pathlib import Path

from recon.cameras.printed_mat import standard_mat
from samples.fruit import fruits_of_seed
from samples.hexahedra import SHIPPED, Fineness
from samples.photo_set import PhotoOptions, write_photos
from samples.sample_batch import Progress, write_answers, write_grasps, write_scan, write_settings

SEED = 2
"""Of both fruit; any number does."""
FEW = 2
"""Photos of the fruit that cannot be graded: two directions do not close a surface."""


def write_two_fruits(folder: Path, *, fineness: Fineness = SHIPPED, progress: Progress | None = None) -> None:
    """N01 with a scanned fruit.ply and two grasps, N02 with two photos and one. Needs the extra `samples`."""
    good, bad = fruits_of_seed(2, seed=SEED)
    folder.mkdir(parents=True, exist_ok=True)
    write_settings(folder, (good, bad), seed=SEED)
    write_scan(folder / "fruits" / good.fruit_id / "fruit.ply", good)
    write_photos(
        folder / "fruits" / bad.fruit_id / "photos", bad, standard_mat(), views=FEW, options=PhotoOptions(),
        progress=progress,
    )  # fmt: skip
    for fruit, grasps in ((good, 2), (bad, 1)):
        where = folder / "fruits" / fruit.fruit_id / "grasps"
        write_grasps(where, fruit, count=grasps, fineness=fineness, progress=progress)
    write_answers(folder, (good, bad), seed=SEED)
