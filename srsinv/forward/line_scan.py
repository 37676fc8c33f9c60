"""The integrated signal of a scan over a line load, (12), with which a rig's curve is compared."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ..errors import refuse
from ..grid import Open
from .scan import ConstantSpeed
from .sensor import Sensor
from .traction import LineLoad

CELLS_PER_SHALLOWEST = 100  # the line's error is of fourth order, and here 1e-8 of the peak
MOST_LINE_CELLS = 2**19


def integrated_scan(
    sensor: Sensor, scan: ConstantSpeed, load_N_per_m: tuple[float, float], position_m: Any
) -> Float[np.ndarray, "e x"]:
    """The signal of a scan over a line load at x = 0, integrated over time from the first position.

    - `load_N_per_m` [N/m]: normal and tangential, p and q.
    - `position_m` (x,) [m]: of the sensor, increasing.

    From the recorded signal of an open line of cells, by a quintic spline's integral over x,
    divided by the speed; the charge's readout as it is, less its first value. Raises `BadInput` for
    positions that take too many cells, of which a depth needs a hundred.
    """
    x = np.asarray(position_m, float)
    cell = float(sensor.depth_m) / CELLS_PER_SHALLOWEST
    low, high = min(x[0], 0.0), max(x[-1], 0.0)  # the load is on the line, too
    count = int(np.ceil((high - low) / cell)) + 12
    refuse(
        count > MOST_LINE_CELLS,
        f"Positions and load extend over {high - low:.3g} m, which needs {count} "
        f"cells, more than {MOST_LINE_CELLS}: give a shorter range, or a deeper film.",
    )
    line = Open(count, cell, low - 6 * cell)
    traction = jnp.stack([LineLoad(each).cell_values(line) for each in load_N_per_m])
    signal = np.asarray(sensor.operator(line, scan)(traction))
    curve = scipy.interpolate.make_interp_spline(np.asarray(line.x), signal, 5, axis=-1)
    if sensor.amplifier.order:
        curve = curve.antiderivative()
        return (curve(x) - curve(x[:1])) / float(scan.speed_m_per_s)
    return curve(x) - curve(x[:1])
