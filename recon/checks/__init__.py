"""Whether photos and mesh can be believed: photo checks, rim evidence, surface error, verdicts."""
