"""The rig: its calibration, what is uncertain of it, and how its channels are wired."""
