"""A run over a batch: one process for each fruit, checks before it, progress, time left, memory."""
