"""A run over a batch: every fruit in a process of its own, checks beforehand, progress, time left, memory."""
