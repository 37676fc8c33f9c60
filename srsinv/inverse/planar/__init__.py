"""Straight features in the plane: their direction from circles and passes, and the next pass."""
