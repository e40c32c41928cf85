"""Photos to a scaled, watertight fruit mesh with its pit."""
