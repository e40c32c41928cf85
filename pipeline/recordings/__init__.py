"""`drupe convert` and `drupe calibrate`: other formats to recordings, presses to sensor descriptions."""
