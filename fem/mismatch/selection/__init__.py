"""Which effect: screening, refinement, model selection, null reference set, cross-validation."""
