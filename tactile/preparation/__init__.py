"""Corrects a logger's faults in a record (wild, repeated, missing, reserved, reset, joined or appended
values) before any fit.

The limits in these modules are set by hand. `python benchmarks/trace_faults.py` scores them on drawn traces.
"""
