"""Synthetic fruit with known answers, by a solver other than fem."""
