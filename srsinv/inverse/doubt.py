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
KEPT = 0.5  # of a wave's amplitude, from which on it counts as told
FEW_MISSING = 0.05  # of the samples
SIGNIFICANT = 5.0  # standard deviations of the root of a chi-square


def prior_alone(name: str, told: float, cells: int) -> Sequence[str]:
    """Of a component of which the signal tells `told` numbers."""
    if told >= LEAST_TOLD:
        return ()
    return (
        f"The signal tells {told:.2g} of the {cells} numbers of {name}: what is shown of it is the "
        "prior, with the prior's band.",
    )


def shared_out(gain: np.ndarray, root: np.ndarray, cells: int) -> Sequence[str]:
    """Of p and q felt through one mix alone.

    `gain` (e, 2, k) is the model over the noise, `root` (2, k) the prior's. Of the second singular
    direction v of each wavenumber the signal tells s^2/(s^2 + v^H P v) numbers.
    """
    small, of_p = _singular(gain.astype(complex))
    held = of_p * root[0].astype(float) ** 2 + (1 - of_p) * root[1].astype(float) ** 2
    told = cells * np.mean(small / np.maximum(small + held, np.finfo(float).tiny))
    if told >= LEAST_TOLD:
        return ()
    return (
        "The elements feel one mix of p and q alone, and how it is shared out is the prior's: "
        f"the signal tells {told:.2g} numbers of their difference.",
    )


def _singular(gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of (e, 2, k): the second singular value squared, and the share of p in its direction.

    The product of both values is what is left of the smaller column beside the larger one, so that
    it keeps its digits where both are nearly one.
    """
    squares = np.sum(np.abs(gain) ** 2, axis=0)
    first = np.where(squares[0] >= squares[1], 0, 1)
    a, b = (np.take_along_axis(gain, at[None, None], 1)[:, 0] for at in (first, 1 - first))
    size, total = squares.max(axis=0), squares.sum(axis=0)
    safe = np.where(size > 0, size, 1.0)
    for _ in range(2):  # the second sweep restores the orthogonality that the first one loses
        b = b - a * np.sum(a.conj() * b, axis=0) / safe
    product = size * np.sum(np.abs(b) ** 2, axis=0)
    large = (total + np.sqrt(np.maximum(total**2 - 4 * product, 0.0))) / 2
    small = product / np.where(large > 0, large, 1.0)
    between = large - small
    of_p = np.where(between > 0, (large - squares[0]) / np.where(between > 0, between, 1.0), 0.5)
    return small, np.clip(of_p, 0.0, 1.0)


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


def beyond_cells(name: str, resolution: float) -> Sequence[str]:
    """Of a component of whose shortest wave the estimate keeps `resolution`."""
    if not resolution > KEPT:
        return ()
    return (
        f"The signal tells {name} down to waves of two cells, so that shorter ones are heard too, "
        "and taken for longer ones: take narrower cells.",
    )


def missing(share: float, stderr_with_all: bool) -> Sequence[str]:
    """Of samples of which `share` is missing within the scan, and standard errors that are perhaps
    those with every sample there."""
    words = []
    if share > FEW_MISSING:
        words.append(
            f"{100 * share:.3g} % of the samples are missing: if their size took them out (rails), "
            "what was strongest is not in the answer."
        )
    if stderr_with_all:
        words.append(
            "The band is that with every sample there, too narrow where some are missing: "
            "path=direct gives their own."
        )
    return words


def undetermined_weights(result: str) -> Sequence[str]:
    """Of weights that a rule chose, or did not."""
    if result in ("converged", "given"):
        return ()
    return (f"The band takes the weights as known, of which the rule says: {result}.",)


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
