"""Exit statuses of all commands, as docs/how-to/grade-a-batch.md lists them."""

DONE = 0
"""The command did everything, and no number is in doubt."""
INTERNAL = 1
"""A fault of drupe: Python's own status after an uncaught exception."""
USAGE = 2
"""drupe refused the command line, the settings or the batch: the usual status of command-line parsers."""
UNUSABLE = 3
"""Some fruit or recording could not be used."""
DOUBTED = 4
"""All fruit are graded, but some number is in doubt."""
INTERRUPTED = 130
"""Ctrl-C: 128 plus the signal's number, as in shells."""
