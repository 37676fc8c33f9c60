"""Samples along a motion to the cells of a line: cells, passes, directions of motion."""
