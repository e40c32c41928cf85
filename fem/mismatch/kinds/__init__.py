"""Base classes of effects of one kind, each with its signatures and its response."""
