"""The catalogue's effects, one per file: parameters, linear signature, nonlinear model."""
