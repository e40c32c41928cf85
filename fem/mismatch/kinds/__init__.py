"""What several effects have in common: kinds of effects, each with its signatures and its response."""
