"""The flesh as an elastic solid around a rigid pit: linear, finite strain, contact, closed forms."""
