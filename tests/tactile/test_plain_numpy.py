"""NumPy's files are read whole, and only where what they unpack to fits into memory."""

import numpy as np
import pytest

import tactile.io.plain_numpy
from pipeline.files.plain_file import NotReadable
from tactile.io.plain_numpy import load_npy, load_npz


def test_arrays_come_back_in_double_precision(tmp_path):
    values = np.arange(12, dtype=np.int16).reshape(3, 4)
    np.save(tmp_path / "a.npy", values)
    np.savez_compressed(tmp_path / "a.npz", one=values, two=2.5 * values)
    np.testing.assert_array_equal(load_npy(tmp_path / "a.npy"), values)
    held = load_npz(tmp_path / "a.npz")
    assert {name: array.dtype for name, array in held.items()} == {"one": float, "two": float}
    np.testing.assert_array_equal(held["two"], 2.5 * values)


def test_bytes_that_would_become_too_many_doubles_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(tactile.io.plain_numpy, "MOST_VALUES", 1000)
    np.savez_compressed(tmp_path / "a.npz", one=np.zeros(600, np.uint8), two=np.zeros(600, np.uint8))
    with pytest.raises(NotReadable, match="more than 1000 values"):
        load_npz(tmp_path / "a.npz")


def test_a_file_cut_short_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(1000))
    (tmp_path / "a.npy").write_bytes((tmp_path / "a.npy").read_bytes()[:4000])
    with pytest.raises(NotReadable, match="cut short"):
        load_npy(tmp_path / "a.npy")
