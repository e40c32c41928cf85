"""Mismatch cases with known answers: recordings that contain physics which the plain model lacks."""
