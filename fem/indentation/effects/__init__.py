"""Physics that a bare indenter's trace can carry, one per file."""
