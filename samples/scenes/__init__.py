"""Photo scenes drawn at random with everything that is true of them known."""
