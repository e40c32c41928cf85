"""Converts other formats to recordings, and writes descriptions of sensors, rigs and robots."""
