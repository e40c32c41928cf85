"""Effects in the force-displacement curve of a bare indenter, one per file."""
