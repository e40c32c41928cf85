"""Markers in gel images: detected, matched, tracked, gaps filled."""
