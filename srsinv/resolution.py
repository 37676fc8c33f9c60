"""How fine a computation is: the one place where a film's depth becomes cells, samples, margins.

Stress decays as e^(-k z), so that what is fine is measured in depths of the shallowest film.
"""

MOST_CELLS = 2**24  # beyond, the arrays over a line take gigabytes each
# Cells, or samples, in a depth.
_IN_A_DEPTH = {
    # Beyond, e^(-k z) is negligible: at the cells' last wavenumber it is e^(-50).
    "inversion": 16,
    # The error of cells falls at least as they do: what is left is a few parts in a thousand.
    "converged_inversion": 64,
    # Half as many, as each costs time: p and q that are averaged over such a cell are as good.
    "live": 8,
    # Each half of the cells then has one every 0.4 depths, where e^(-k z) is 4e-4.
    "comparison": 5,
    # The signal of a load's edge is then right to 1e-6 of its peak, of a line load to 1e-5.
    "load": 32,
    "load_search": 8,
    "simulated_load": 256,
    "timed_load": 16,
    # At least: a surface's edges jump by cells, which has to be less than the signal shows.
    "contact": 256,
    "contact_search": 12,
    "contact_search_samples": 4,
    "ridge_search": 2,  # of a straight ridge on a circle
}
# Depths beyond the scan's ends.
_MARGINS = {
    "traction": 8,  # over which it still gives a signal
    "fade": 16,  # over which what repeats fades out
}


def cell_m(purpose: str, depth_m: float) -> float:
    """The width [m] of cells, or the distance of samples, under a film so deep [m]."""
    return depth_m / _IN_A_DEPTH[purpose]


def margin_m(purpose: str, depth_m: float) -> float:
    """The margin [m] beyond each end of a scan."""
    return _MARGINS[purpose] * depth_m


def in_words(purpose: str) -> str:
    """The cells in a depth, as a number."""
    return str(_IN_A_DEPTH[purpose])
