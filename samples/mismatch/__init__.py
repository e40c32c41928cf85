"""Mismatch cases with known answers: what recordings look like when one piece of physics is left out."""
