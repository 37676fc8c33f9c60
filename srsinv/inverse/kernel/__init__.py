"""The kernel of a sensor, measured over a known input: see `measure`."""
