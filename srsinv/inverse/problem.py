"""Input and result of every inversion: `Problem` and `Estimate`."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Complex, Float

from ..errors import refuse
from ..grid import Convolution, Line, as_real
from ..status import Status
from .quality import Quality, quality, reasons

COMPONENTS = ("p", "q")
FAINT = 1e-3  # a gain at k = 0 below this fraction of the largest leaves a mean unobservable


class Problem(eqx.Module):
    """Signals, their linear model, and further known quantities.

    The model is data = forward(r) + noise with r (c, n) the traction [Pa]: both components
    ("p and q apart"), or p alone where `friction` says q = mu p.

    - `data` (e, n): signal less its known offset and less the signal of the known means; zero where
      it is missing.
    - `noise` (k,): power per sample at `line.k` (see `forward.noise`); infinite at k = 0 where the
      signal's offset is not known, which takes its mean out of the data.
    - `observed` (e, n): mask of valid samples; None means all.
    - `known_mean_Pa`: for each component its mean over the window where it is known, else None.
    - `background_Pa`: for each component a uniform traction that continues beyond the window of an
      open line, which is unobservable; it is added to the estimate. None: not known.
    - `friction`: mu in q = mu p; None leaves p and q apart.
    - `zero_mean` (c,): whether only the deviation from the mean is solved for: where the mean is
      known, and where it is unobservable.
    - `mean_signal` (e, n): the signal of the known means.

    Raises `BadInput` where shapes disagree, a number is not finite, fewer than three samples are
    valid, the noise is zero, the model is zero, or one element is asked for p and q apart.
    """

    line: Line
    forward: Convolution
    data: Float[Array, "e n"]
    noise: Float[Array, " k"]
    observed: Bool[Array, "e n"] | None
    known_mean_Pa: tuple[Float[Array, ""] | None, Float[Array, ""] | None]
    background_Pa: tuple[Float[Array, ""] | None, Float[Array, ""] | None]
    friction: Float[Array, ""] | None
    zero_mean: Bool[Array, " c"]
    mean_signal: Float[Array, "e n"]

    def __init__(
        self,
        line: Line,
        forward: Convolution,
        data,
        noise,
        *,
        observed=None,
        known_mean_Pa: Sequence[float | Array | None] = (None, None),
        background_Pa: Sequence[float | Array | None] = (0.0, 0.0),
        friction=None,
    ):
        data, noise = as_real(data), as_real(noise)
        _check(line, forward, data, noise, observed, friction, known_mean_Pa)
        if friction is not None:
            friction = as_real(friction)
            transfer = forward.transfer[:, :1] + friction * forward.transfer[:, 1:]
            forward = dataclasses.replace(forward, transfer=transfer)
        self.line, self.forward, self.noise, self.friction = line, forward, noise, friction
        observed = None if observed is None or np.all(observed) else jnp.asarray(observed)
        self.observed = observed
        self.known_mean_Pa = _pair(known_mean_Pa)
        self.background_Pa = _pair(background_Pa)
        self.zero_mean = _has_zero_mean(forward, noise, self._known)
        self.mean_signal, self.data = _less_means(
            forward, data, observed, self.known_mean_Pa[: self.unknowns]
        )

    @property
    def unknowns(self) -> int:
        """Number of components that are solved for."""
        return self.forward.transfer.shape[1]

    @property
    def separable(self) -> bool:
        """Whether each wavenumber can be treated alone: a periodic line with every sample valid."""
        return self.forward.is_circular and self.observed is None

    @property
    def information(self) -> Float[Array, "c k"]:
        """Fisher information on each component at line.k, sum over elements of |G|^2/N [1/Pa^2], of
        the nearest periodic problem."""
        gain = jnp.abs(self.forward.circulant().transfer * self.whitener) ** 2
        return jnp.sum(gain, axis=0)

    @property
    def whitener(self) -> Float[Array, " k"]:
        """N^(-1/2) at line.k."""
        return 1 / jnp.sqrt(self.noise)

    @property
    def samples(self) -> int:
        """Number of valid samples, over all elements."""
        return int(self.data.size if self.observed is None else np.sum(np.asarray(self.observed)))

    @eqx.filter_jit
    def free_offset(self, y: Float[Array, "e n"]) -> Float[Array, "e 1"]:
        """The mean of y over the valid samples, where the signal's offset is not known and absorbs
        it; else zero."""
        is_observed = jnp.ones(y.shape, bool) if self.observed is None else self.observed
        count = jnp.maximum(jnp.sum(is_observed, axis=-1, keepdims=True), 1)
        mean = jnp.sum(jnp.where(is_observed, y, 0.0), axis=-1, keepdims=True) / count
        return jnp.where(jnp.isfinite(self.noise[0]), 0.0, mean)

    @property
    def mean_is_observable(self) -> Bool[Array, " c"]:
        """For each unknown, whether its mean is observable.

        Its gain at k = 0 must not vanish, nor be proportional to another unknown's.
        """
        return _is_observable(self.forward, self.noise, self._known)

    @property
    def _known(self) -> tuple[bool, ...]:
        return tuple(mean is not None for mean in self.known_mean_Pa[: self.unknowns])

    def mean_statement(self) -> dict[str, str]:
        """Origin of the estimate's mean for p and q, in words."""
        return {name: self._mean_of(c) for c, name in enumerate(COMPONENTS)}

    def _mean_of(self, c: int) -> str:
        if c >= self.unknowns:
            return f"follows from p by q = mu p with mu = {self.friction:.4g}"
        known, background = self.known_mean_Pa[c], self.background_Pa[c]
        if background is None:
            return "unobserved: the estimate is the deviation from a background that is not known"
        if known is not None:
            return f"known from outside: {float(known + background):.6g} Pa"
        if bool(self.mean_is_observable[c]):
            return "from the signal"
        if self.forward.is_circular:
            return "unobserved: the signal is blind to it; the estimate is the deviation from it"
        return "weakly observed: only what the window's ends show of it"


@eqx.filter_jit
def _is_observable(forward: Convolution, noise, known: tuple[bool, ...]) -> Bool[Array, " c"]:
    """For each unknown, whether its gain at k = 0 is neither zero nor proportional to another's."""
    gain = forward.transfer[..., 0]
    largest = jnp.max(jnp.abs(forward.transfer))
    size = jnp.linalg.norm(jnp.abs(gain), axis=0)
    observable = forward.has_dc_gain & (size > FAINT * largest) & jnp.isfinite(noise[0])
    unit = jnp.where(observable, gain / jnp.where(observable, size, 1.0), 0.0)
    overlap = jnp.abs(unit.conj().T @ unit) - jnp.eye(len(known))
    alike = jnp.any((overlap > 1 - FAINT**2) & ~np.array(known)[:, None], axis=0)
    return observable & ~alike


@eqx.filter_jit
def _has_zero_mean(forward: Convolution, noise, known: tuple[bool, ...]) -> Bool[Array, " c"]:
    # On an open line the window's ends respond weakly to every mean.
    return jnp.asarray(known) | (~_is_observable(forward, noise, known) & forward.is_circular)


@eqx.filter_jit
def _less_means(forward: Convolution, data, observed, means):
    """The signal of the known means, and the data without it, zero where they are missing."""
    each = jnp.stack([jnp.zeros(()) if mean is None else mean for mean in means])
    level = forward(jnp.tile(each[:, None], (1, data.shape[-1])))
    data = data - level
    return level, data if observed is None else jnp.where(observed, data, 0.0)


def _pair(values: Sequence[float | Array | None]):
    p, q = (None if value is None else as_real(value) for value in values)
    return p, q


def _check(line, forward, data, noise, observed, friction, known_mean_Pa) -> None:
    elements = forward.transfer.shape[0]
    shape = (elements, line.n)
    refuse(
        data.shape != shape,
        f"The data have shape {data.shape}: the model expects (element, sample) = {shape}.",
    )
    refuse(
        noise.shape != line.k.shape,
        f"The noise has shape {noise.shape}: give its power at the {line.n // 2 + 1} wavenumbers "
        "line.k.",
    )
    is_observed = np.ones(shape, bool) if observed is None else np.asarray(observed)
    refuse(
        is_observed.shape != shape,
        f"observed has shape {is_observed.shape}: give one truth value for each of {shape}.",
    )
    refuse(
        friction is None and elements < 2,
        "One element cannot tell p from q: give friction (q = mu p) or a second element.",
    )
    count = int(np.sum(np.any(is_observed, axis=0)))
    refuse(count < 3, f"Only {count} samples are there: an inversion needs at least 3.")
    if not isinstance(data, Tracer):
        bad = is_observed & ~np.isfinite(np.asarray(data))
        refuse(
            bool(bad.any()),
            f"The data hold {int(bad.sum())} samples that are nan or infinite: mark them as not "
            "there in observed, or correct them.",
        )
    if not isinstance(noise, Tracer):
        level = np.asarray(noise)
        usable = (level > 0) & (np.isfinite(level) | (np.arange(level.size) == 0))
        worst = int(np.argmin(usable))
        refuse(
            not usable.all(),
            f"The noise is {'zero' if level[worst] == 0 else level[worst]} at wavenumber number "
            f"{worst}: give a power above 0 (infinite at number 0 alone, for an offset that is "
            "not known).",
        )
    for name, value in (("friction", friction), *zip(("known mean of p", "known mean of q"),
                                                      known_mean_Pa, strict=True)):  # fmt: skip
        refuse(
            value is not None and not isinstance(value, Tracer) and not np.isfinite(value),
            f"The {name} is {value}: give a finite number.",
        )
    if not isinstance(forward.transfer, Tracer):
        refuse(
            not bool(np.any(np.asarray(forward.transfer))),
            "The model's signal is zero for every traction (no speed, or no gain): there is "
            "nothing to invert.",
        )


class Estimate(eqx.Module):
    """Recovered traction with its uncertainty.

    - `value` (2, n): p and q [Pa]; `stderr` (2, n): posterior standard error [Pa] of the value
      where its mean is observable, else of its deviation from the mean (on an open line: over the
      cells with samples).
    - `covariance`: (c, c, k) per wavenumber on the spectral and the iterative path, (c n, c n) on
      the direct one.
    - `status`: how the solution ended; `warnings`: sentences on the validity of the bands
      (see diagnostics.py); `quality`: good, doubtful or failed.
    - `stats`: numbers of the solution (iterations, weights, `resolved_dof_p`, `resolved_dof_q`, the
      effective degrees of freedom of each, and `chi2_per_freedom` of the residual's
      `degrees_of_freedom`, None where coloured noise has gaps).
    - `fitted` (e, n): the fitted signal; `whitened` (e, n): residual over the noise, NaN where a
      sample is missing.
    - `averaging` (c, c, n): the estimate's response to a unit traction in the middle cell; the
      transform of its diagonal is the resolution at each wavenumber.
    """

    value: Float[Array, "2 n"]
    stderr: Float[Array, "2 n"]
    covariance: Complex[Array, "c c k"] | Float[Array, "m m"]
    fitted: Float[Array, "e n"]
    whitened: Float[Array, "e n"]
    averaging: Float[Array, "c c n"]
    status: Status = eqx.field(static=True, converter=Status)
    warnings: tuple[str, ...] = eqx.field(static=True)
    stats: dict[str, Any] = eqx.field(static=True)

    def with_stats(self, stats: dict[str, Any]) -> "Estimate":
        """The same estimate with further stats."""
        return dataclasses.replace(self, stats=stats | self.stats)

    def with_warnings(self, warnings: Sequence[str]) -> "Estimate":
        """The same estimate with further warnings."""
        return dataclasses.replace(self, warnings=(*self.warnings, *warnings))

    @property
    def quality(self) -> Quality:
        """Good, doubtful or failed."""
        chi2, freedom = self.stats.get("chi2_per_freedom"), self.stats.get("degrees_of_freedom")
        return quality(self.status, chi2, self.warnings, np.inf if freedom is None else freedom)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the quality is not good, as sentences."""
        return reasons(self.status, self.warnings)
