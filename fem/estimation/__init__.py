"""Young's modulus from recordings: noise, least squares, error budget, joint inference with the pit."""
