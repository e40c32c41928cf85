"""Exit statuses of all commands, as docs/how-to/grade-a-batch.md lists them."""

DONE = 0
"""All that was asked for is done, with no doubt."""
INTERNAL = 1
"""A fault of the program: what Python itself ends with."""
USAGE = 2
"""Command line, settings or batch are refused: what command-line parsers end with."""
UNUSABLE = 3
"""Some fruit or recording could not be used."""
DOUBTED = 4
"""All are graded, some number is in doubt."""
INTERRUPTED = 130
"""Ctrl-C: 128 and the signal's number, as shells have it."""
