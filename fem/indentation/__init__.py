"""Diagnosis from a bare indenter's force over travel and time: detection, model selection, held-out frames,
advice."""
