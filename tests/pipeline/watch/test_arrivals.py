"""What a look at a fruit's folder sees: its own parts, linked or not, and no other folder."""

import pytest

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import FruitFolder
from pipeline.watch import arrivals


@pytest.fixture
def fruit(tmp_path):
    root = tmp_path / "fruits" / "A"
    (root / "grasps").mkdir(parents=True)
    return root


def put(*paths):
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("content")


def seen(root):
    """Names of the files that a look sees, from the fruit's folder on."""
    state = arrivals.arrival(FruitFolder(root), FruitRow(fruit_id=root.name)).state
    return {name.removeprefix(f"{root}/") for name, _, _ in state}


def test_parts_of_a_fruit_are_seen_wherever_they_lie(fruit, tmp_path):
    disk = tmp_path / "disk"
    put(disk / "photos" / "1.jpg", disk / "grasp" / "grasp.toml", disk / "frames" / "0.png")
    put(fruit / "fruit.ply", fruit / "grasps" / "grasp-1.h5", fruit / "grasps" / "grasp-2" / "left" / "0.png")
    (fruit / "photos").symlink_to(disk / "photos")
    (fruit / "grasps" / "grasp-3").symlink_to(disk / "grasp")
    (fruit / "grasps" / "grasp-3" / "left").symlink_to(disk / "frames")
    assert seen(fruit) == {
        "fruit.ply",
        "photos/1.jpg",
        "grasps/grasp-1.h5",
        "grasps/grasp-2/left/0.png",
        "grasps/grasp-3/grasp.toml",
        "grasps/grasp-3/left/0.png",
    }


def test_folders_that_are_no_part_of_a_fruit_are_not_entered(fruit, tmp_path):
    """A link may lead to a whole disk, which one look would take minutes to go through."""
    disk = tmp_path / "disk"
    put(disk / "deep" / "a" / "b.png", disk / "a.png")
    put(fruit / "notes" / "a.txt", fruit / "grasps" / "grasp-1" / "grasp.toml")
    for place in ("x", "grasps/y", "grasps/grasp-1/left"):
        (fruit / place).symlink_to(disk)
    assert seen(fruit) == {"grasps/grasp-1/grasp.toml", "grasps/grasp-1/left/a.png"}


def test_a_look_goes_through_no_more_files_than_a_fruit_may_have(fruit, monkeypatch):
    monkeypatch.setattr(arrivals, "MOST_FILES", 5)
    put(*(fruit / "photos" / f"{k}.jpg" for k in range(9)))
    assert len(seen(fruit)) == 5
