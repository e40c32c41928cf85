"""Readers and writers: HDF5 recordings, raw frames, Tac3D, tables, load cells, sensor descriptions."""
