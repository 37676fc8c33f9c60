"""Patterns that are periodic along x: their pitch, and which lines are there."""
