"""A recording in which the HDF5 library would never come to an end is refused in seconds."""

import shutil
import time
from pathlib import Path

import h5py
import pytest

import tactile.hdf5_texts
from tactile.failure import TactileFailure
from tactile.hdf5_texts import texts_can_be_read
from tactile.recording import read_recording

SHIPPED = (
    Path(__file__).parents[2] / "samples" / "data" / "nectarines" / "fruits" / "N01" / "grasps" / "grasp-1.h5"
)


def with_a_broken_heap(path):
    """The length of the category, kept before it in the file's heap, made not to lead to the next text."""
    data = bytearray(shutil.copy(SHIPPED, path).read_bytes())
    data[data.index(b"nectarine", data.index(b"GCOL")) - 8] = 215
    path.write_bytes(data)
    return path


def test_a_sound_file_can_be_read_at_once():
    began = time.monotonic()
    assert texts_can_be_read(SHIPPED)
    assert time.monotonic() - began < 5


def test_a_heap_without_an_end_is_refused(tmp_path, monkeypatch):
    path = with_a_broken_heap(tmp_path / "grasp-1.h5")
    assert not texts_can_be_read(path, patience_s=1.0)
    monkeypatch.setattr(tactile.hdf5_texts.texts_can_be_read, "__kwdefaults__", {"patience_s": 1.0})
    with pytest.raises(TactileFailure, match=r"grasp-1\.h5") as refused:
        read_recording(path)
    assert "copy it again" in str(refused.value)


def test_links_are_not_followed_to_find_out(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    target = with_a_broken_heap(tmp_path / "elsewhere" / "other.h5")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["pads"] = h5py.ExternalLink(str(target), "/pads")
    assert texts_can_be_read(tmp_path / "a.h5", patience_s=1.0)
