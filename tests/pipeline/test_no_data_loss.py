"""No command writes onto what it reads, nor over files of others; two writers wait for each other."""

import errno
import fcntl
import hashlib
import json
import multiprocessing
import os
import shutil
import time
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest
from small_batches import contents, empty_batch

from pipeline.batch.layout import FruitResults, Results, write_whole
from pipeline.batch.write_guard import LOCK, is_held, require_made_by_drupe, results_lock, same_place
from pipeline.files.manifest import LIST_LOCK, NotOurs, in_the_way, json_in, writing_alone
from pipeline.problem import BatchRefused

SETTINGS = 'category = "nectarine"\npoisson_ratio = 0.45\n'
PRECIOUS = b"the only copy"


def make_batch(root):
    empty_batch(root, "N01", "N02", settings=SETTINGS)
    for fruit in (root / "fruits").iterdir():
        (fruit / "photos").mkdir()
        for name in ("fruit.ply", "pit.ply", "grasps/grasp-1.h5"):
            (fruit / name).write_bytes(PRECIOUS)
    return root


@pytest.fixture
def batch(tmp_path):
    return make_batch(tmp_path / "season" / "batch")


@pytest.fixture
def refused(drupe, tmp_path):
    """Runs a command that must be refused and leave every file as it is; what it says."""

    def run(*arguments):
        before = contents(tmp_path)
        ran = drupe(*arguments, status=2)
        assert "Traceback" not in ran.err
        assert contents(tmp_path) == before
        return ran.err

    return run


@pytest.mark.parametrize(
    "out",
    [
        "batch",
        "batch/../batch",
        ".",
        "batch/fruits",
        "batch/fruits/N01",
        "batch/fruits/N01/results",
        "batch/fruits/N02/photos/a/b",
        "other/fruits/new",
        "link-to-batch/fruits/new",
        "link-to-batch",
        "link-to-fruits",
        "other",
    ],
)
def test_results_never_go_onto_into_or_above_a_batch(refused, batch, out):
    season = batch.parent
    make_batch(season / "other")
    (season / "link-to-batch").symlink_to(batch)
    (season / "link-to-fruits").symlink_to(batch / "fruits")
    for command in (("grade", batch), ("explain", batch, "--fruit", "N01")):
        said = refused(*command, "--out", season / out)
        assert f"drupe: {season / out}: " in said
        assert "with --out" in said


@pytest.mark.parametrize("place", ["fruits", "fruits/new/results", "fruits/N01", "fruits/N01/photos"])
def test_results_never_go_among_the_files_of_another_batchs_fruit(refused, batch, tmp_path, place):
    other = make_batch(tmp_path / "other")
    (other / "fruits" / "N01" / "photos" / "1.jpg").write_bytes(PRECIOUS)
    said = refused("grade", batch, "--out", other / place)
    assert "fruits, which is read and never written into" in said


def test_a_link_inside_the_results_is_never_written_through(refused, batch, tmp_path):
    precious = tmp_path / "precious.csv"
    precious.write_bytes(PRECIOUS)
    out = tmp_path / "out"
    (out / "fruits").mkdir(parents=True)
    Results(out).claim()
    (out / "ranking.csv").symlink_to(precious)
    assert "ranking.csv: is a link" in refused("grade", batch, "--out", out)
    (out / "ranking.csv").unlink()
    shutil.copytree(batch / "fruits" / "N01", tmp_path / "mine", ignore=shutil.ignore_patterns("p*os", "gr*"))
    (out / "fruits" / "N01").symlink_to(tmp_path / "mine")
    assert "N01: is a link" in refused("grade", batch, "--out", out)
    (batch / "results").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").mkdir()
    assert "is a link; name the place" in refused("grade", batch)


def test_writing_replaces_a_link_and_not_what_it_leads_to(tmp_path):
    (tmp_path / "precious").write_bytes(PRECIOUS)
    (tmp_path / "file").symlink_to(tmp_path / "precious")
    write_whole(tmp_path / "file", "new")
    assert (tmp_path / "precious").read_bytes() == PRECIOUS
    assert (tmp_path / "file").read_text() == "new"


@pytest.mark.parametrize("name", ["fruit.ply", "pit.ply", "record.json", "photo.jpg", "mismatch.json"])
def test_a_strangers_file_among_the_results_is_refused_by_name(refused, batch, tmp_path, name):
    theirs = tmp_path / "out" / "fruits" / "N02" / name
    theirs.parent.mkdir(parents=True)
    Results(tmp_path / "out").claim()
    os.link(batch / "fruits" / "N02" / "fruit.ply", theirs)
    said = refused("grade", batch, "--out", tmp_path / "out")
    assert f"{theirs}: was not written by drupe" in said
    assert "move it away" in said


@pytest.mark.parametrize("name", ["ranking.json", "ranking.csv", ".run.json"])
def test_a_file_in_the_way_is_found_before_fruit_are_worked_on(refused, batch, tmp_path, name):
    out = tmp_path / "out"
    Results(out).claim()
    write_whole(out / name, "drupe's")
    (out / name).write_bytes(PRECIOUS)
    assert f"{out / name}: was changed since drupe wrote it" in refused("grade", batch, "--out", out)


@pytest.mark.parametrize("name", ["batch.toml", "grasp-1.h5", "notes.txt", "ranking.csv", "fruits/N01/x"])
def test_a_folder_that_drupe_did_not_make_is_no_folder_of_results(refused, batch, tmp_path, name):
    (tmp_path / "out" / name).parent.mkdir(parents=True)
    (tmp_path / "out" / name).write_bytes(PRECIOUS)
    said = refused("grade", batch, "--out", tmp_path / "out")
    assert f"holds {Path(name).parts[0]} and was not made by drupe, so it is no folder of results" in said


def test_what_drupe_wrote_is_forgotten_and_what_others_wrote_or_changed_is_not(tmp_path):
    results = FruitResults(tmp_path / "fruits" / "N01")
    results.claim()
    for path in (results.record, results.fruit_ply, results.pit_ply):
        write_whole(path, "ours")
    results.pit_ply.write_bytes(PRECIOUS)
    (results.root / "notes.txt").write_bytes(PRECIOUS)
    results.photo.write_bytes(PRECIOUS)
    assert set(in_the_way(results.files)) == {results.pit_ply, results.photo}
    results.forget()
    assert not results.record.exists()
    assert not results.fruit_ply.exists()
    for path in (results.pit_ply, results.photo, results.root / "notes.txt"):
        assert path.read_bytes() == PRECIOUS
    with pytest.raises(NotOurs, match=r"pit\.ply: was not written by drupe, or was changed since"):
        write_whole(results.pit_ply, "new")


def test_a_run_killed_between_list_and_file_leaves_nothing_unknown(tmp_path, monkeypatch):
    results = FruitResults(tmp_path)
    results.claim()
    write_whole(results.record, "first")
    with monkeypatch.context() as killed:
        killed.setattr("pipeline.batch.layout.put", lambda *_: None)
        write_whole(results.record, "never written")
    assert not list(in_the_way(results.files))
    write_whole(results.record, "third")
    assert results.record.read_text() == "third"


@pytest.mark.parametrize("name", [".written.json", "batch.json", "fruits/N01/.written.json"])
@pytest.mark.parametrize("kind", ["pipe", "link", "deep", "strange"])
def test_what_stands_in_place_of_a_list_or_record_is_not_waited_for_nor_replaced(
    refused, batch, tmp_path, name, kind
):
    path = tmp_path / "out" / name
    path.parent.mkdir(parents=True)
    if name != ".written.json":
        Results(tmp_path / "out").claim()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "link":
        path.symlink_to("/dev/zero")
    else:
        path.write_text('{"format": ' + "[" * 50_000 if kind == "deep" else "my notes")
    said = refused("grade", batch, "--out", tmp_path / "out")
    other = f"holds {name} and was not made by drupe"
    assert f"{path}: was not written by drupe" in said or f"{path}: is a link" in said or other in said


def test_a_list_that_names_other_places_gives_no_right_to_them(refused, batch, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "precious.csv").write_bytes(PRECIOUS)
    (out / "ranking.csv").write_bytes(PRECIOUS)
    digest = hashlib.sha256(PRECIOUS).hexdigest()
    for names in (["../precious.csv", str(tmp_path / "precious.csv")], ["ranking.csv"]):
        listed = {name: [digest] if name[0] in "./" else 5 for name in names}
        (out / ".written.json").write_text(json.dumps({"format": "drupe-written", "files": listed}))
        said = refused("grade", batch, "--out", out)
        assert "was not written by drupe" in said or "was not made by drupe" in said


@pytest.fixture
def case(tmp_path):
    folder = tmp_path / "case"
    folder.mkdir()
    for name in ("fruit.ply", "pit.ply", "grasp-1.h5"):
        (folder / name).write_bytes(PRECIOUS)
    (folder / "case.toml").write_text(SETTINGS)
    return folder


@pytest.mark.parametrize(
    "target", ["case/fruit.ply", "case/grasp-1.h5", "case/new.json", "linked.json", "notes.txt", "batch.json"]
)
def test_an_answer_never_takes_the_place_of_a_file(refused, case, tmp_path, target):
    os.link(case / "pit.ply", tmp_path / "linked.json")
    (tmp_path / "notes.txt").write_bytes(PRECIOUS)
    (tmp_path / "batch.json").write_text(json.dumps({"format": "drupe-batch-result"}))
    for option in ("--json", "--html"):
        refused("explain", case, option, tmp_path / target)


@pytest.mark.parametrize("place", ["pipe", "/dev/zero"])
def test_no_command_waits_for_a_pipe_or_reads_a_device_in_place_of_its_output(refused, case, tmp_path, place):
    (tmp_path / "t.csv").write_bytes(PRECIOUS)
    (tmp_path / "sensor.toml").write_text('kind = "markers-mono"\n')
    os.mkfifo(tmp_path / "pipe")
    os.mkfifo(tmp_path / "mat.json")
    (tmp_path / "press").mkdir()
    for command in (
        ("explain", case, "--json", tmp_path / place),
        ("explain", case, "--html", tmp_path / place),
        ("convert", tmp_path / "t.csv", tmp_path / place, "--sensor", tmp_path / "sensor.toml"),
        ("calibrate", tmp_path / "sensor.toml", tmp_path / place, "--load-cell", tmp_path / "press"),
        ("mat", tmp_path),
    ):
        assert "so it is not overwritten" in refused(*command)


def test_two_answers_never_share_a_file_nor_take_a_name_of_the_results(refused, batch, case, tmp_path):
    both = ("--json", tmp_path / "a", "--html", tmp_path / "case" / ".." / "a")
    assert "give two names" in refused("explain", case, *both)
    Results(batch / "results").claim()
    fruit = batch / "results" / "fruits" / "N01"
    fruit.mkdir(parents=True)
    for path in (fruit / "mismatch.json", fruit / ".written.json", batch / "results" / "ranking.csv"):
        said = refused("explain", batch, "--fruit", "N01", "--json", path)
        assert "is a file of the results" in said


def test_a_name_too_long_for_a_file_is_compared_as_any_other(tmp_path):
    long, other = (tmp_path / (letter * 300) for letter in "ab")
    assert same_place(long, tmp_path / "." / long.name)
    assert same_place(long, tmp_path / "folder" / ".." / long.name)
    assert not same_place(long, other)
    assert not same_place(long, tmp_path)
    assert not same_place(tmp_path, long)


@pytest.mark.parametrize("work", ["case", "case/work", ".", "full"])
def test_meshes_are_not_kept_in_or_around_the_case(refused, case, tmp_path, work):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "fruit.ply").write_bytes(PRECIOUS)
    assert "with --work" in refused("explain", case, "--work", tmp_path / work)


def test_an_answer_of_a_batch_goes_nowhere_into_the_batch(refused, batch, tmp_path):
    for target in ("mat.json", "fruits/N01/fruit.ply", "fruits/N01/a.json", "fruits.csv"):
        refused("explain", batch, "--fruit", "N01", "--json", batch / target)


def test_a_table_is_never_converted_onto_itself_or_another(refused, tmp_path):
    (tmp_path / "raw").mkdir()
    for name in ("t.csv", "u.csv", "sensor.toml", "raw/grasp.toml", "theirs.h5"):
        (tmp_path / name).write_bytes(PRECIOUS)
    with h5py.File(tmp_path / "recorded.h5", "w") as file:
        file.attrs["format"] = "drupe-recording"
    (tmp_path / "link.csv").symlink_to(tmp_path / "t.csv")
    os.link(tmp_path / "t.csv", tmp_path / "hard.csv")
    sensor = ("--sensor", tmp_path / "sensor.toml")
    for out in ("t.csv", "u.csv", "link.csv", "hard.csv", "sensor.toml", "theirs.h5", "recorded.h5"):
        said = refused("convert", tmp_path / "t.csv", tmp_path / out, *sensor)
        assert "is not overwritten" in said
    for value in (np.arange(3), np.zeros(2, dtype=[("a", "i4")])):
        with h5py.File(tmp_path / "strange.h5", "w") as file:
            file.attrs["written_by"] = value
        said = refused("convert", tmp_path / "t.csv", tmp_path / "strange.h5", *sensor)
        assert "is not overwritten" in said
    said = refused("convert", tmp_path / "raw", tmp_path / "raw" / "out.h5")
    assert "is read and never written into" in said


def test_a_sensors_description_is_never_calibrated_onto_itself_or_another_file(refused, tmp_path):
    (tmp_path / "sensor.toml").write_text('kind = "markers-mono"\n')
    (tmp_path / "press").mkdir()
    for name in ("press/log.csv", "other.toml"):
        (tmp_path / name).write_bytes(PRECIOUS)
    options = ("--load-cell", tmp_path / "press")
    for out in ("sensor.toml", "other.toml"):
        said = refused("calibrate", tmp_path / "sensor.toml", tmp_path / out, *options)
        assert "is not overwritten" in said
    within = ("calibrate", tmp_path / "sensor.toml", tmp_path / "press" / "log.csv", *options)
    assert "is read and never written into" in refused(*within)
    assert "is a folder" in refused("calibrate", tmp_path / "sensor.toml", ".", *options)
    (tmp_path / "sensor.toml").write_text("a = " + "[" * 5000 + "]" * 5000)
    deep = refused("calibrate", tmp_path / "sensor.toml", "out.toml", *options)
    assert "is nested too deep" in deep


def test_a_mat_takes_no_other_mats_place(drupe, refused, tmp_path):
    assert drupe("mat", tmp_path).status == 0
    assert drupe("mat", tmp_path).status == 0
    assert "mat.pdf: exists and is not this mat's mat.pdf" in refused("mat", tmp_path, "--cherry")
    (tmp_path / "mat.pdf").unlink()
    assert "mat.json: exists" in refused("mat", tmp_path, "--cherry")


def test_a_sample_appears_whole_and_only_in_an_empty_folder(drupe, refused, tmp_path, monkeypatch):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_bytes(PRECIOUS)
    assert "is not empty" in refused("sample", tmp_path / "taken")
    file = tmp_path / "taken" / "notes.txt"
    assert f"{file}: is a file; give a new" in refused("sample", file)
    assert f"{file}: is or lies in a file, not" in refused("sample", file / "new")
    with monkeypatch.context() as full:
        full.setattr(shutil, "copytree", _disk_full_after_one_file)
        said = refused("sample", tmp_path / "new", "--name", "two-fruits")
    assert "new: cannot be written (No space left on device); free space" in said
    assert drupe("sample", tmp_path / "new", "--name", "two-fruits").status == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new", "taken"]


def test_a_sample_in_the_current_folder_leaves_it_the_same_folder(drupe, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert drupe("sample", ".", "--name", "two-fruits").status == 0
    assert Path("batch.toml").is_file()


def _disk_full_after_one_file(source, target, **_):
    Path(target).mkdir()
    shutil.copyfile(Path(source) / "batch.toml", Path(target) / "batch.toml")
    raise OSError(28, "No space left on device", str(target))


def test_what_drupe_wrote_is_read_whatever_its_size(tmp_path, monkeypatch):
    """batch.json of a large batch, without which nobody knows whose results these are."""
    monkeypatch.setattr("pipeline.files.manifest.MOST_BYTES", 1000)
    results = Results(tmp_path)
    results.claim()
    content = {"format": "drupe-batch-result", "inputs": {f"photo-{k}.jpg": "0" * 64 for k in range(100)}}
    write_whole(results.provenance, json.dumps(content))
    assert json_in(results.provenance) == content
    results.provenance.write_text(json.dumps({**content, "batch": "elsewhere"}))
    assert json_in(results.provenance) is None


SPAWN = multiprocessing.get_context("spawn")


def write_all(root, which, refused):
    """The files of a fruit, again and again."""
    fruit = FruitResults(root)
    fruit.claim()
    for k in range(20):
        for path in (fruit.record, fruit.fruit_ply, fruit.picture):
            try:
                write_whole(path, f"{which} {k}")
            except OSError as error:
                refused.put(str(error))
    refused.put("")


def test_two_workers_on_one_fruit_refuse_each_other_nothing(tmp_path):
    refused = SPAWN.Queue()
    workers = [SPAWN.Process(target=write_all, args=(tmp_path, which, refused)) for which in range(2)]
    for worker in workers:
        worker.start()
    said = []
    while said.count("") < 2:
        said.append(refused.get(timeout=60))
    for worker in workers:
        worker.join()
    assert said == ["", ""]
    assert not list(in_the_way(FruitResults(tmp_path).files))
    assert {path.name for path in tmp_path.iterdir()} == {
        *("record.json", "fruit.ply", "mesh.webp"),
        *(".written.json", LIST_LOCK),
    }


def hold(lock, root, begun):
    """Never lets go."""
    with lock(root):
        begun.set()
        time.sleep(600)


@contextmanager
def held_by_another(lock, root):
    """A process that holds the lock of a folder and does not end."""
    begun = SPAWN.Event()
    process = SPAWN.Process(target=hold, args=(lock, root, begun))
    process.start()
    assert begun.wait(60)
    try:
        yield process
    finally:
        process.kill()
        process.join()


def test_one_that_was_killed_holds_up_nobody(tmp_path):
    FruitResults(tmp_path).claim()
    with held_by_another(writing_alone, tmp_path):
        pass
    began = time.monotonic()
    write_whole(tmp_path / "record.json", "new")
    assert time.monotonic() - began < 5
    assert not list(in_the_way(FruitResults(tmp_path).files))


def test_without_locks_or_in_place_of_one_a_folder_it_is_written_all_the_same(tmp_path, monkeypatch):
    def none(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    with monkeypatch.context() as without:
        without.setattr(fcntl, "flock", none)
        FruitResults(tmp_path).claim()
        write_whole(tmp_path / "record.json", "first")
        with results_lock(tmp_path):
            assert not is_held(tmp_path)
    (tmp_path / LIST_LOCK).unlink()
    (tmp_path / LIST_LOCK).mkdir()
    write_whole(tmp_path / "record.json", "second")
    assert (tmp_path / "record.json").read_text() == "second"


@pytest.mark.parametrize("left", [LIST_LOCK, LOCK, "..written.json.drupe-part-0a1b2c3d"])
def test_a_run_killed_as_it_began_leaves_a_folder_that_the_next_takes(tmp_path, left):
    (tmp_path / left).touch()
    require_made_by_drupe(tmp_path, "--out")


def test_results_that_another_run_writes_are_refused_until_it_ends(tmp_path):
    with held_by_another(results_lock, tmp_path):
        assert is_held(tmp_path)
        with (
            pytest.raises(BatchRefused, match=r"another run is writing here and holds \.lock"),
            results_lock(tmp_path),
        ):
            pass
    with results_lock(tmp_path):
        assert is_held(tmp_path)
