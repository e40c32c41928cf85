"""Mismatch between a fruit's recordings and the plain model: its presence, cause, place and time."""
