"""From posteriors to the measured kernel and the directions of its error."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...numerics import root_of
from .evidence import Posterior, Prior, posterior
from .means import Mean
from .measured import MeasuredKernel
from .signals import KernelSignals

KEPT = 1e-3  # of the variance of the kernel's slope, which a rate sees: error directions left out


class Moved(NamedTuple):
    """Kernels (e, 2, m), their factors far away (e, 2), and directions of both (j, ...)."""

    value: Float[np.ndarray, "e 2 m"]
    far: Float[np.ndarray, "e 2"]
    directions: Sequence[tuple[np.ndarray, ...]]

    def plus(self, other: "Moved") -> "Moved":
        """Both together."""
        directions = [*self.directions, *other.directions]
        return Moved(self.value + other.value, self.far + other.far, directions)


def moved(
    signals: KernelSignals, found: Posterior, prior: Prior, mean: Mean, elements: Sequence[int]
) -> Moved:
    """What the posterior adds to the prior's mean, and the directions of its error."""
    basis = signals.basis(prior.envelope)
    value = np.tensordot(found.t, mean.kernel_slope, 1)
    moves, directions = np.array(mean.kernel_slope), []
    for e, given in zip(elements, found.elements, strict=True):
        value[e] += _at_lags(given.coefficients(found.t)[:, None], basis)[0]
        moves[:, e] += _at_lags(given.moved, basis)
        spread = np.zeros((given.root.shape[0], *mean.kernel.shape))
        spread[:, e] = _at_lags(given.factor, basis)
        directions.append((spread, np.zeros(spread.shape[:-1])))
    root = root_of(found.covariance)
    shared = (np.tensordot(root.T, each, 1) for each in (moves, mean.far_slope))
    far = np.tensordot(found.t, mean.far_slope, 1)
    return Moved(value, far, [tuple(shared), *directions])


def moved_by_gains(
    signals: KernelSignals, prior: Prior, mean: Mean, elements: Sequence[int]
) -> tuple[Float[np.ndarray, "j e 2 m"], Float[np.ndarray, "j e 2"]]:
    """What gains that vary from pass to pass leave open of these elements' kernels and of their
    factors far away: H (g_j y), with H the map from the signals y to the kernels under this prior,
    and g_j the gains of the means over passes, in independent directions (see `PassGains`)."""
    none = np.zeros_like(mean.kernel), np.zeros_like(mean.far)
    values, fars = [np.zeros((0, *each.shape)) for each in none]
    for gains in signals.gain_errors:
        own = Mean(*none, signals.data * (1 - gains[:, None]), *mean[3:])
        about = signals.about(own)
        products = [about[e].under(prior.envelope) for e in elements]
        found = posterior(products, prior, signals.k, np.zeros(len(mean.far_slope)))
        change = moved(signals, found, prior, own, elements)
        values, fars = (
            np.concatenate([every, each[None]])
            for every, each in ((values, change.value), (fars, change.far))
        )
    return values, fars


def as_kernel(
    signals: KernelSignals,
    moved: Moved,
    parameters: Mapping[str, tuple[float, float]],
    chi2: float,
    stats: Mapping[str, float],
) -> MeasuredKernel:
    """The kernel, its error in the fewest directions; `chi2` of what it leaves."""
    known = signals.known
    freedom = signals.sample_count - stats["resolved_dof"]
    kept = [strongest(*each) for each in moved.directions if len(each[0])]
    factors, far_factors = (np.concatenate(each) for each in zip(*kept, strict=True))
    variance = sum(np.sum(each**2, axis=0) for each, _ in moved.directions)
    return MeasuredKernel(
        signals.lags, moved.value, np.sqrt(variance), factors, moved.far, far_factors, parameters,
        float(known.scan.speed_m_per_s), known.effective_friction, signals.has_both_ways,
        chi2 / max(freedom, 1.0), freedom, stats,
    )  # fmt: skip


def _at_lags(
    coefficients: Float[np.ndarray, "a j"], basis: Float[np.ndarray, "2 b m"]
) -> Float[np.ndarray, "j 2 m"]:
    """Kernels of p and q of the coefficients of their waves."""
    by_component = coefficients.reshape(2, -1, coefficients.shape[1]).swapaxes(1, 2)
    return (by_component @ basis).swapaxes(0, 1)


def strongest(
    kernel: Float[np.ndarray, "j e 2 m"], far: Float[np.ndarray, "j e 2"]
) -> tuple[Float[np.ndarray, "i e 2 m"], Float[np.ndarray, "i e 2"]]:
    """The fewest independent directions of the same error, but for `KEPT` of the variance of the
    kernel's slope, which is what a rate shows."""
    slope = np.diff(kernel, axis=-1).reshape(len(kernel), -1)
    values, axes = np.linalg.eigh(slope @ slope.T)
    order = np.argsort(values)[::-1]
    left = 1 - np.cumsum(values[order]) / np.sum(values)
    own = axes[:, order[: int(np.argmax(left < KEPT)) + 1]]
    return np.tensordot(own.T, kernel, 1), np.tensordot(own.T, far, 1)
