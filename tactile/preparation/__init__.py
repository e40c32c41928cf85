"""Corrects what a logger did to a record (wild, repeated, missing, reserved, reset, joined or appended
values) before anything is fitted.

The limits in these modules are set by hand. `python benchmarks/trace_faults.py` scores them on drawn traces.
"""
