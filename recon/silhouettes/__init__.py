"""Outlines of the fruit: background plate, segmentation, voxel hull, visual hull."""
