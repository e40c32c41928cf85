"""A bare indenter's force over travel and time, explained: detect, name, model, prove, suggest."""
