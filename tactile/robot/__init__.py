"""A robot's frames: where the mat lies in the robot's base, and from that the pads' poses."""
