"""What a logger did to a record (wild, repeated, missing, reserved, reset, joined or appended values) is put
right before anything is fitted.
"""
