"""Which effect: screening, refinement, model selection, the decision, cross-validation."""
