"""What a gel's cameras and law tell: depth by stereo, forces from displacement."""
