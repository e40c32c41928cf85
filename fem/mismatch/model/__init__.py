"""The plain model of all recordings, and the responses that effects are built from."""
