"""Linear Gaussian evidence of effects, with nuisances and the model-discrepancy prior."""
