"""Turns records of graded fruit into CSV, JSON and HTML that people read."""
