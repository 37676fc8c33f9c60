"""What speaks against the bands of an estimate: where the answer is the prior alone, and where data
and model disagree.

Under the model, the squares of the whitened residual add up to the samples less the numbers that
were fitted, and those of the traction in units of its prior to the numbers fitted of it: both are
chi-square. Bands hold what the model allows, and are too narrow where these do not.
"""

from collections.abc import Sequence

import numpy as np

LEAST_TOLD = 1.0  # numbers: with fewer, a component's estimate is its prior
OVER_NOISE = 1.25  # in rms: bands so much too narrow cover 81 % in place of 90 %
OVER_PRIOR = 2.0  # of a prior: edges alone make 1.5 where the bands still cover
SIGNIFICANT = 5.0  # standard deviations of the root of a chi-square


def prior_alone(name: str, told: float, cells: int) -> Sequence[str]:
    """Of a component of which the signal tells `told` numbers."""
    if told >= LEAST_TOLD:
        return ()
    return (
        f"The signal tells {told:.2g} of the {cells} numbers of {name}: what is shown of it is the "
        "prior, with the prior's band.",
    )


def beyond_prior(name: str, squares: float, told: float) -> Sequence[str]:
    """Of a component whose squares in units of the prior are to be `told`."""
    excess = _excess(squares, told, OVER_PRIOR)
    if not excess:
        return ()
    return (
        f"{name} is {excess:.2g} times as strong as its prior allows, so that its band is too "
        "narrow: take a wider prior (a larger rms_Pa or scale=evidence, a smaller weight).",
    )


def beyond_noise(squares: float, freedom: float) -> Sequence[str]:
    """Of a whitened residual whose squares are to be `freedom`."""
    excess = _excess(squares, freedom, OVER_NOISE)
    if not excess:
        return ()
    return (
        f"The residual is {excess:.2g} times the noise, so that bands are too narrow: the model "
        "leaves out what acts on the signal, or the noise is larger than stated.",
    )


def below_rounding(noise_rms: float, largest: float, dtype: np.dtype) -> Sequence[str]:
    """Of noise that is less than the rounding of the data."""
    if noise_rms >= np.finfo(dtype).eps * largest:
        return ()
    return (
        f"The noise ({noise_rms:.2g}) is less than the rounding of {dtype.name} on data of "
        f"{largest:.2g}, which the bands leave out.",
    )


def _excess(squares: float, freedom: float, most: float) -> float:
    """The root of squares over freedom where it is above `most`, and no chance, else 0."""
    if not freedom >= LEAST_TOLD:
        return 0.0
    ratio = float(np.sqrt(squares / freedom))
    chance = 1 + SIGNIFICANT / np.sqrt(2 * freedom)
    return ratio if ratio > max(most, chance) else 0.0
