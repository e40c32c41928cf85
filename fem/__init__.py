"""Mechanics of flesh around a rigid pit: forward model, modulus, closed forms."""
