"""The reference's contact: the pressure under a profile to 1 %, by numpy.

The solution that simulations take (srsinv/forward/contact.py) runs in a tenth of the time that it
takes to compile, and a scene is screened once.
"""

import numpy as np
from jaxtyping import Float

ENOUGH = 1e-3  # of the profile's height: the gap's error
MOST_STEPS = 200


def pressure_under(
    height_m: Float[np.ndarray, " n"], nominal_Pa: float, compliance: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " n"]:
    """Cell averages of pressure [Pa] whose mean is `nominal_Pa`, under a profile that repeats, with
    `compliance` [m/Pa] that of cells at the half spectrum, zero at k = 0.

    Full contact by its formula; else conjugate gradients on the contact set, begun anew whenever a
    cell parts or enters (Polonsky and Keer 1999).
    """
    n, height = height_m.size, height_m - height_m.mean()

    def displacement(values):
        return np.fft.irfft(compliance * np.fft.rfft(values), n)

    stiffness = np.divide(1.0, compliance, out=np.zeros_like(compliance), where=compliance > 0)
    full = nominal_Pa + np.fft.irfft(stiffness * np.fft.rfft(height), n)
    if full.min() >= 0:
        return full
    p, way, last, goes_on = np.full(n, float(nominal_Pa)), np.zeros(n), 1.0, False
    for _ in range(MOST_STEPS):
        touching = p > 0
        gap = displacement(p) - height
        gap -= gap[touching].mean()
        wrong = max(np.abs(gap[touching]).max(), -gap.min())
        if wrong <= ENOUGH * np.ptp(height):
            break
        square = float(gap[touching] @ gap[touching])
        way = np.where(touching, gap + goes_on * square / last * way, 0.0)
        answer = displacement(way)
        answer -= answer[touching].mean()
        bent = float(answer @ way)
        # A single cell that touches has nowhere to go by itself.
        length = float(gap @ way) / bent if bent > 0 else stiffness[-1]
        p = np.maximum(p - length * way, 0.0)
        entering = (p == 0) & (gap < 0)
        p[entering] -= length * gap[entering]
        p *= nominal_Pa / p.mean()
        last, goes_on = square, not entering.any()
    return p
