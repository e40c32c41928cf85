"""A stage is computed once per key, and a damaged store is computed again."""

import io
import json
import os

import numpy as np
import pytest
from jaxtyping import Float

from pipeline.batch import cache
from pipeline.batch.cache import HEADER, StageRecord, cached, file_hash, stage_key
from pipeline.batch.records import read_record


@pytest.mark.parametrize("changed", ["fem/law.py", "fem/laws/more/hertz.py", "fem/null_reference.csv"])
def test_a_change_of_a_rooms_code_is_another_version_of_it_alone(tmp_path, monkeypatch, changed):
    """Wherever drupe is installed, a folder called data included."""
    places = tmp_path / "data" / "packages"
    for name in (changed, "recon/mesh.py", "fem/data/sample.csv"):
        (places / name).parent.mkdir(parents=True, exist_ok=True)
        (places / name).write_text("1")
    monkeypatch.setattr(cache, "PACKAGES", places)

    def versions():
        cache.code_version.cache_clear()
        return [cache.code_version((room,)) for room in ("fem", "recon")]

    fem, recon = versions()
    (places / "fem/data/sample.csv").write_text("2")
    assert versions() == [fem, recon]
    (places / changed).write_text("2")
    after = versions()
    assert after[0] != fem
    assert after[1] == recon
    with pytest.raises(FileNotFoundError, match="holds no source files"):
        cache.code_version(("tactile",))
    cache.code_version.cache_clear()


def test_a_library_that_is_not_installed_has_no_version(monkeypatch):
    monkeypatch.setattr(cache, "LIBRARIES", ("numpy", "no-such-library"))
    assert dict(cache.library_versions.__wrapped__()) == {"numpy": np.__version__}


def test_every_rooms_own_files_are_its_version():
    versions = [cache.code_version((room,)) for room in cache.ROOMS]
    assert len(set(versions)) == len(cache.ROOMS)
    assert all((cache.PACKAGES / room / "__init__.py").is_file() for room in cache.ROOMS)


class Kept(StageRecord):
    a: Float[np.ndarray, " n"]
    n: int


def make(counter):
    def compute():
        counter.append(1)
        return Kept(a=np.arange(3.0), n=3)

    return compute


def keep(folder, stage, key, compute):
    return cached(folder, stage, key, compute, record=Kept)


@pytest.mark.parametrize(
    ("key", "most_bytes", "computed"), [("k", None, 1), ("other", None, 2), ("k", 100, 2)]
)
def test_only_a_second_call_with_the_same_key_and_the_whole_file_computes_nothing(
    tmp_path, key, most_bytes, computed
):
    calls, path = [], tmp_path / "mesh.npz"
    first = keep(tmp_path, "mesh", "k", make(calls))
    path.write_bytes(path.read_bytes()[:most_bytes])
    second = keep(tmp_path, "mesh", key, make(calls))
    assert len(calls) == computed
    np.testing.assert_array_equal(first.a, second.a)
    assert second.n == 3


@pytest.mark.parametrize(
    "text",
    [
        '{"n": 3}',
        '{"a": {"__array__": "a"}}',
        '{"a": {"__array__": "b"}, "n": 3}',
        '{"a": {"__array__": "a"}, "n": "x"}',
        "[]",
        "no JSON",
    ],
)
def test_a_file_of_the_key_that_holds_another_record_is_computed_again(tmp_path, text):
    header = json.dumps({"key": "k", "record": text})
    buffer = io.BytesIO()
    np.savez(buffer, **{HEADER: np.array(header), "a": np.arange(2.0)})
    (tmp_path / "mesh.npz").write_bytes(buffer.getvalue())
    calls = []
    assert len(keep(tmp_path, "mesh", "k", make(calls)).a) == 3
    assert len(calls) == 1


@pytest.mark.parametrize("at", [b"k\0\0\0e\0\0\0y", b"\0\0\xf0?", b"PK\x01\x02"])
def test_a_damaged_file_is_computed_again(tmp_path, at):
    """Of the header, of the array and of the table of contents."""
    path, calls = tmp_path / "mesh.npz", []
    keep(tmp_path, "mesh", "k", make(calls))
    data = bytearray(path.read_bytes())
    data[data.index(at)] ^= 1
    path.write_bytes(data)
    np.testing.assert_array_equal(keep(tmp_path, "mesh", "k", make(calls)).a, np.arange(3.0))
    assert len(calls) == 2


def test_a_pipe_or_a_device_in_the_cache_is_never_waited_for(tmp_path):
    os.mkfifo(tmp_path / "mesh.npz")
    (tmp_path / "pit.npz").symlink_to("/dev/zero")
    for stage in ("mesh", "pit"):
        calls = []
        keep(tmp_path, stage, "k", make(calls))
        keep(tmp_path, stage, "k", make(calls))
        assert len(calls) == 1
    os.mkfifo(tmp_path / "pipe")
    assert file_hash(tmp_path / "pipe") == "unreadable: is a named pipe, not a file"
    assert read_record(tmp_path / "pipe") is None


def test_the_key_follows_contents_settings_and_stage(tmp_path):
    file = tmp_path / "f"
    file.write_text("one")

    def key(stage="mesh", setting=1):
        return stage_key(stage, files=[file], settings={"s": setting}, rooms=("recon",))

    first = key()
    assert key() == first
    assert key(setting=2) != first
    assert key(stage="pit") != first
    file.write_text("two")
    assert key() != first
