"""Frames of a robot: the mat's pose in the robot's base, and the pads' poses that follow."""
