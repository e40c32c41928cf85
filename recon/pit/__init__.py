"""The pit: category priors, a measured pit, and its placement in the fruit."""
