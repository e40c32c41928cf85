"""What a gel's cameras and law tell: depth by shading or stereo, forces from displacement."""
