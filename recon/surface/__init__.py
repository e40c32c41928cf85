"""The fruit's surface: relief by photo-consistency, Poisson reconstruction, underside, repair."""
