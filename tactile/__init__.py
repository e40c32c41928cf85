"""Gel frames to displacement and force on the fruit."""
