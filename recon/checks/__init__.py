"""Checks of photos and mesh: photo checks, rim evidence, surface error, verdicts."""
