"""The Cramer-Rao bound of a ridge's direction on a circle."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from srsinv.forward.planar import PathScan
from srsinv.grid import as_real
from srsinv.inverse.planar.signal import PlanarSignal, RidgeShape, information, standard_errors


def angle_bounds_deg(
    circling: PathScan,
    ridge: Mapping[str, float],
    angles_deg: Float[np.ndarray, " angle"],
    snr_dB: float,
) -> Float[np.ndarray, " angle"]:
    """The Cramer-Rao bound [deg] on the standard error of a ridge's angle, at each of `angles_deg`:
    all five parameters unknown, white noise `snr_dB` below the rms signal.

    `ridge`: its `distance_m`, `width_m`, `load_N_per_m` and `friction`.
    """
    signal, load = PlanarSignal(RidgeShape(), (circling,)), ridge["load_N_per_m"]
    others = ridge["distance_m"], ridge["width_m"], load, load * ridge["friction"]
    unit = np.ones(len(circling.sensor.elements))

    def bound(angle_deg: float) -> float:
        row = as_real(np.array([angle_deg, *others]))
        clean = np.asarray(signal(dict(zip(RidgeShape.names, row, strict=True))))
        rms = 10 ** (-snr_dB / 20) * np.sqrt(np.mean(clean**2))
        known = np.asarray(information(signal, row, as_real(unit)))
        return float(rms * standard_errors(known.sum(axis=0))[0])

    return np.array([bound(angle) for angle in angles_deg])
