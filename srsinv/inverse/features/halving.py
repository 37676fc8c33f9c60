"""Whether the cells that contact is solved on show in a fit: half as wide ones tell.

The signal of a solved contact is off by 1e-5 to 3e-5 of its rms on the cells of a fit (six random
ridges against cells an eighth as wide), and by a fifth to two fifths of that on half as wide ones.
"""

import numpy as np
from jaxtyping import Float

from ..nonlinear import Fit

COARSE = 2e-4  # of a signal's rms: the error of the cells is less
NOTICED = 0.2  # standard errors by which cells may move a parameter


def cells_may_show(fit: Fit) -> bool:
    """Whether the signal is so strong beside its noise that an error of `COARSE` may be noticed:
    by any parameter at most that of the whole signal, in units of the noise."""
    return COARSE * float(np.linalg.norm(fit.whitened_signal())) > NOTICED


def are_noticed(moves: Float[np.ndarray, " m"], fit: Fit) -> bool:
    """Whether these moves of a fit's parameters exceed `NOTICED` standard errors."""
    return bool(np.any(np.abs(moves) > NOTICED * np.sqrt(np.diag(fit.covariance))))
