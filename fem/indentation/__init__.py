"""Diagnosis from a bare indenter's curves: detection, model selection, held-out frames, advice."""
