"""The linear model of signals on the cells of a line: whitening, known means, chi-square.

It also says whether the means of p and q over the window are observable.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from ...grid import Convolution, Line
from ...known import array_module, by_numpy, is_traced
from ...quantities import quantity
from ..estimate import COMPONENTS, Numbers

# A gain at k = 0 below this fraction of the largest leaves a mean unobservable.
OBSERVABLE_GAIN = 1e-3


@by_numpy
def are_observable(
    forward: Convolution, noise: Float[Numbers, "#e k"], known: tuple[bool, ...], xp: Any = jnp
) -> Bool[Any, " c"]:
    """For each unknown, whether its gain at k = 0 is neither zero nor proportional to another's."""
    gain = forward.transfer[..., 0]
    largest = xp.max(xp.abs(forward.transfer))
    size = xp.linalg.norm(xp.abs(gain), axis=0)
    observable = (
        forward.has_dc_gain & (size > OBSERVABLE_GAIN * largest) & xp.all(xp.isfinite(noise[:, 0]))
    )
    unit = xp.where(observable, gain / xp.where(observable, size, 1.0), 0.0)
    overlap = xp.abs(unit.conj().T @ unit) - xp.eye(len(known))
    alike = xp.any((overlap > 1 - OBSERVABLE_GAIN**2) & ~np.array(known)[:, None], axis=0)
    return observable & ~alike


@by_numpy
def have_zero_mean(
    forward: Convolution, noise: Float[Numbers, "#e k"], known: tuple[bool, ...], xp: Any = jnp
) -> Bool[Any, " c"]:
    """For each unknown, whether only its deviation from the mean is solved for."""
    # On an open line the window's ends respond weakly to every mean.
    return xp.asarray(known) | (~are_observable(forward, noise, known) & forward.is_circular)


@by_numpy
def less_means(forward: Convolution, data, observed, means, xp: Any = jnp):
    """The signal of the known means, and the data without it, zero where they are missing."""
    each = xp.stack([xp.zeros((), data.dtype) if mean is None else mean for mean in means])
    level = xp.zeros_like(data)
    if xp is jnp or each.any():
        level = forward(xp.tile(each[:, None], (1, data.shape[-1])))
    data = data - level
    return level, data if observed is None else xp.where(observed, data, 0.0)


CHI2, FREEDOM = "chi2_per_freedom", "degrees_of_freedom"


class EstimateParts(NamedTuple):
    """Parts of an estimate: p and q [Pa] and their standard error (2, n), the fitted signal and the
    whitened residual (e, n), and the sum of the latter's squares."""

    value: Float[Numbers, "2 n"]
    stderr: Float[Numbers, "2 n"]
    fitted: Float[Numbers, "e n"]
    whitened: Float[Numbers, "e n"]
    squares: Float[Numbers, ""]


class LineModel(eqx.Module):
    """Signals and their linear model, data = forward(r) + noise: [`LineProblem`][] has what each
    field is."""

    line: eqx.AbstractVar[Line]
    forward: eqx.AbstractVar[Convolution]
    data: eqx.AbstractVar[Float[Array, "e n"]]
    noise: eqx.AbstractVar[Float[Array, "#e k"]]
    observed: eqx.AbstractVar[Bool[Numbers, "e n"] | None]
    noise_scale: eqx.AbstractVar[Float[Array, "e n"] | None]
    known_mean_Pa: eqx.AbstractVar[tuple[Float[Array, ""] | None, Float[Array, ""] | None]]
    background_Pa: eqx.AbstractVar[tuple[Float[Array, ""] | None, Float[Array, ""] | None]]
    friction: eqx.AbstractVar[Float[Array, ""] | None]
    nuisance: eqx.AbstractVar[Float[Array, "e column n"] | None]
    zero_mean: eqx.AbstractVar[Bool[Array, " c"]]
    mean_signal: eqx.AbstractVar[Float[Array, "e n"]]

    @property
    def is_observed(self) -> Bool[Any, "e n"]:
        """The mask of valid samples; traced where it is."""
        if self.observed is None:
            return np.ones(self.data.shape, bool)
        return array_module(self.observed).asarray(self.observed)

    @property
    def observed_cells(self) -> Bool[np.ndarray, " n"]:
        """Cells at which at least one element was sampled."""
        return np.any(self.is_observed, axis=0)

    @property
    def noise_rms(self) -> float:
        """Standard deviation of a sample's noise, an unknown offset aside."""
        return float(np.sqrt(np.mean(np.asarray(self.noise)[:, 1:])))

    @property
    def surrounding_pressure_Pa(self) -> float:
        """The pressure around the features, as far as it is known."""
        known = self.known_mean_Pa[0], self.background_Pa[0]
        return sum(float(each) for each in known if each is not None)

    @property
    def has_free_offset(self) -> bool:
        """Whether each element's signal has a constant that is not known."""
        return not bool(np.isfinite(np.asarray(self.noise)[:, 0]).all())

    @property
    def unknowns(self) -> int:
        """Number of components that are solved for."""
        return self.forward.transfer.shape[1]

    @property
    def separable(self) -> bool:
        """Whether each wavenumber can be treated alone: a periodic line with every sample valid,
        all of them under the same noise, and nothing else on them."""
        further = self.observed, self.noise_scale, self.nuisance
        return self.forward.is_circular and all(each is None for each in further)

    @property
    def information(self) -> Float[Numbers, "c k"]:
        """Fisher information on each component at line.k, sum over elements of |G|^2/N [1/Pa^2], of
        the nearest periodic problem."""
        return _information(self.forward.circulant().transfer, self.whitener)

    @property
    def whitener(self) -> Float[Numbers, "#e k"]:
        """N^(-1/2) at line.k, one row for all elements or one for each."""
        return _over_root(self.noise)

    @property
    def sample_count(self) -> Any:
        """Number of valid samples, over all elements; traced where the mask is."""
        if self.observed is None:
            return int(self.data.size)
        observed: Any = self.observed
        return jnp.sum(observed) if is_traced(observed) else int(np.sum(observed))

    @by_numpy
    def free_offset(self, y: Float[Numbers, "e n"], xp: Any = jnp) -> Float[Numbers, "e 1"]:
        """The mean of y over the valid samples, where the signal's offset is not known and absorbs
        it; else zero."""
        scale = self.noise_scale
        weights = xp.ones(y.shape, y.dtype) if scale is None else 1 / scale**2
        if self.observed is not None:
            y, weights = (xp.where(self.observed, each, 0.0) for each in (y, weights))
        total = xp.maximum(xp.sum(weights, axis=-1, keepdims=True), np.finfo(y.dtype).tiny)
        mean = xp.sum(weights * y, axis=-1, keepdims=True) / total
        return xp.where(xp.isfinite(self.noise[:, :1]), 0.0, mean)

    @property
    def mean_is_observable(self) -> Bool[Any, " c"]:
        """For each unknown, whether its mean is observable.

        Its gain at k = 0 must not vanish, nor be proportional to another unknown's.
        """
        return are_observable(self.forward, self.noise, self._known)

    @property
    def mean_weights(self) -> Float[Numbers, "c n"]:
        """The weights of each unknown's mean over the sampled cells where standard errors are those
        of the deviation from it, else zero.

        So they are on an open line if the signal hardly determines the mean, whose error would
        exceed all others, or if the traction is a deviation from a background that is not known.
        """
        if self.forward.is_circular:
            return np.broadcast_to(0.0, (self.unknowns, self.line.n))
        return self._mean_weights()

    @by_numpy
    def _mean_weights(self, xp: Any = jnp) -> Float[Numbers, "c n"]:
        is_deviation = np.array([each is None for each in self.background_Pa[: self.unknowns]])
        hidden = xp.where(self.zero_mean, is_deviation, ~self.mean_is_observable)
        ones = xp.ones(self.data.shape, bool) if self.observed is None else self.observed
        cells = xp.any(ones, axis=0).astype(self.data.dtype)
        return hidden[:, None] * (cells / xp.sum(cells))[None, :]

    @by_numpy
    def estimate_parts(
        self, traction: Float[Numbers, "c n"], stderr: Float[Numbers, "c n"], xp: Any = jnp
    ) -> EstimateParts:
        """What an estimate shows of a solution: see `EstimateParts`."""
        fitted = self.forward(xp.asarray(traction))
        left = self.data - fitted
        whitened = self.whitened(left)
        return EstimateParts(
            *with_means(self, traction, stderr),
            fitted + self.mean_signal + self.free_offset(left),
            whitened,
            xp.nansum(whitened**2),
        )

    @by_numpy
    def whitened(self, residual: Float[Numbers, "e n"], xp: Any = jnp) -> Float[Numbers, "e n"]:
        """The residual in units of the noise, NaN where a sample is missing."""
        residual = residual - self.free_offset(residual)
        white = self.whitener
        if self.noise_scale is not None:  # an offset is then no wave of the line's length
            residual = residual / self.noise_scale
            at_zero = xp.where(white[:, :1] > 0, white[:, :1], white[:, 1:2])
            white = xp.concatenate([at_zero, white[:, 1:]], axis=1)
        observed = self.observed
        if observed is not None:
            residual = xp.where(observed, residual, 0.0)
        whitened = xp.fft.irfft(xp.fft.rfft(residual) * white, self.line.n)
        return whitened if observed is None else xp.where(observed, whitened, np.nan)

    @property
    def _known(self) -> tuple[bool, ...]:
        return tuple(mean is not None for mean in self.known_mean_Pa[: self.unknowns])

    def mean_statement(self) -> dict[str, str]:
        """Origin of the estimate's mean for p and q, in words."""
        return {name: self._mean_of(c) for c, name in enumerate(COMPONENTS)}

    @property
    def mean_unobserved(self) -> tuple[str, ...]:
        """The components whose mean the signal does not show, or hardly."""
        is_observable = self.mean_is_observable
        if is_traced(is_observable):  # what is known without numbers
            is_observable = [self.forward.has_dc_gain] * self.unknowns
        return tuple(
            name
            for c, name in enumerate(COMPONENTS[: self.unknowns])
            if self.background_Pa[c] is None
            or (self.known_mean_Pa[c] is None and not is_observable[c])
        )

    def _mean_of(self, c: int) -> str:
        if c >= self.unknowns:
            return f"follows from p by q = mu p with mu = {self.friction:.4g}"
        known, background = self.known_mean_Pa[c], self.background_Pa[c]
        if background is None:
            return "unobserved: the estimate is the deviation from an unknown background"
        if known is not None:
            return f"known: {quantity(float(known) + float(background), 'Pa', 4)}"
        if np.asarray(self.mean_is_observable)[c]:
            return "from the signal"
        if self.forward.is_circular:
            return "unobserved: the estimate is the deviation from it"
        return "weakly observed: only the ends of the window depend on it"


@by_numpy
def _information(
    transfer: Complex[Numbers, "e c k"], white: Float[Numbers, "#e k"], xp: Any = jnp
) -> Float[Numbers, "c k"]:
    return xp.sum(xp.abs(transfer * white[:, None]) ** 2, axis=0)


@by_numpy
def _over_root(power: Float[Numbers, "#e k"], xp: Any = jnp) -> Float[Numbers, "#e k"]:
    return 1 / xp.sqrt(power)


def with_means(
    model: LineModel, traction: Float[Numbers, "c n"], stderr: Float[Numbers, "c n"]
) -> tuple[Float[Numbers, "2 n"], Float[Numbers, "2 n"]]:
    """p and q with the means that are known, and their standard error."""
    xp = traction.__array_namespace__()
    pairs = zip(model.known_mean_Pa, model.background_Pa, strict=True)
    means = [
        sum((xp.asarray(m) for m in pair if m is not None), xp.zeros((), traction.dtype))
        for pair in pairs
    ]
    if model.friction is not None:
        friction = xp.asarray(model.friction)
        traction = xp.concatenate([traction, friction * traction])
        stderr = xp.concatenate([stderr, xp.abs(friction) * stderr])
        means[1] = friction * means[0]
    return traction + xp.stack(means)[:, None], stderr


def chi2(model: LineModel, resolved_dof: float, squares: float) -> dict[str, float | None]:
    """Chi-square of the residual per degree of freedom, from the whitened residual's sum of
    squares; None where it is undefined."""
    offsets = model.data.shape[0] if model.has_free_offset else 0
    freedom = float(model.sample_count - offsets - resolved_dof)
    return {CHI2: squares / freedom if freedom >= 1 else None, FREEDOM: freedom}
