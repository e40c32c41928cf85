"""What the plain model leaves out of a fruit's recordings: whether, what, where and when."""
