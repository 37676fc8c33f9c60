"""Bursts of catch and snap, found together with the traction from elements along the travel."""
