"""Checked files: every changed bit is noticed, and other programs still open what is kept."""

import io
import os

import h5py
import numpy as np
import pytest

from pipeline.files.checked_file import is_whole, put_checked, read_checked


def _zip(path):
    buffer = io.BytesIO()
    np.savez(buffer, a=np.arange(50.0))
    put_checked(path, buffer.getvalue())
    return buffer.getvalue()


def _hdf5(path):
    with h5py.File(path, "w") as file:
        file["a"] = np.arange(50.0)
    data = path.read_bytes()
    put_checked(path, data)
    return data


def _text(path):
    put_checked(path, b'["one note"]')
    return b'["one note"]'


@pytest.mark.parametrize("make", [_zip, _hdf5, _text])
def test_no_flipped_bit_and_no_cut_is_missed(tmp_path, make):
    path = tmp_path / "kept"
    data = make(path)
    assert read_checked(path) == data
    assert is_whole(path)
    sound = path.read_bytes()
    for bit in np.random.default_rng(1).integers(0, 8 * len(sound), 300):
        spoilt = bytearray(sound)
        spoilt[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(spoilt)
        assert read_checked(path) is None
        assert not is_whole(path)
    for cut in (0, 10, len(sound) // 2, len(sound) - 1):
        path.write_bytes(sound[:cut])
        assert read_checked(path) is None
        assert not is_whole(path)


def test_numpy_and_hdf5_open_checked_files(tmp_path):
    _zip(tmp_path / "a.npz")
    _hdf5(tmp_path / "a.h5")
    np.testing.assert_array_equal(np.load(tmp_path / "a.npz")["a"], np.arange(50.0))
    with h5py.File(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(file["a"][()], np.arange(50.0))


def test_a_pipe_a_folder_and_nothing_are_not_whole_and_are_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder", "nothing"):
        assert read_checked(tmp_path / name) is None
        assert not is_whole(tmp_path / name)
