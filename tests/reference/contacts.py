"""Closed forms of frictionless contact of a half space (Johnson 1985, 4.2 and 13.2).

Cell averages are differences of the load up to a place, which is what a solver with cell averages
has to give. SI units.
"""

import numpy as np


def westergaard_load(x, length, nominal, load_fraction):
    """Load [N/m] up to x under h = D cos(2 pi x/L) at `nominal` = `load_fraction` x the full
    pressure.

    p = 2 p0 cos(pi x/L) sqrt(s^2 - sin^2(pi x/L))/s^2 with s^2 = `load_fraction`, from the crest at
    0.
    """
    s = np.sqrt(load_fraction)
    turns = np.floor(x / length + 0.5)
    sine = np.clip(np.sin(np.pi * (x - turns * length) / length), -s, s)
    half = sine * np.sqrt(s**2 - sine**2) + s**2 * np.arcsin(sine / s)
    return nominal * length * (half / (np.pi * s**2) + turns)


def westergaard_full(height, length, modulus):
    """The nominal pressure of full contact, pi E* D/L."""
    return np.pi * modulus * height / length


def hertz_half_width(load, radius, modulus):
    """Half the width of a cylinder's contact, a^2 = 4 P R/(pi E*)."""
    return np.sqrt(4 * load * radius / (np.pi * modulus))


def cell_averages(load, x, cell):
    """Mean pressure over cells centred on x, from the load up to a place."""
    return (load(x + cell / 2) - load(x - cell / 2)) / cell
