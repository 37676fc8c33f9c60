"""Finished cells as lines of text."""

from collections.abc import Iterator

import numpy as np

from ..inverse.live.live import LiveCells

HEADER = "x_m,p_Pa,p_stderr_Pa,q_Pa,q_stderr_Pa,noise_{unit}"


def lines_of(cells: LiveCells) -> Iterator[str]:
    """A line for each cell, as `HEADER` names its numbers; of the noise the rms over elements."""
    noise = np.sqrt(np.mean(cells.noise**2, axis=0))
    columns = (cells.x_m, cells.p_Pa, cells.p_stderr_Pa, cells.q_Pa, cells.q_stderr_Pa, noise)
    for row in zip(*(column.tolist() for column in columns), strict=True):
        yield ",".join(f"{value:.9g}" for value in row)
