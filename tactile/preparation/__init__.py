"""What a logger did to a trace, put right before anything is fitted: wild, repeated, missing, reserved, reset,
joined and appended values.
"""
