"""What every inversion takes and gives back."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from ..errors import refuse
from ..grid import Convolution, Line, as_real

COMPONENTS = ("p", "q")


class Problem(eqx.Module):
    """Signals, the model that explains them, and what is known beside them.

    The model is data = forward(r) + noise with r (c, n) the traction [Pa]: both components
    ("p and q apart"), or p alone where `friction` says q = mu p.

    - `data` (e, n): signal less its known offset; zero where it is missing.
    - `noise` (k,): power per sample at `line.k` (see `forward.noise`); infinite at k = 0 where the
      signal's offset is not known, which takes its mean out of the data.
    - `observed` (e, n): which samples are there; None means all.
    - `known_mean_Pa`: for each component its mean over the window where the experimenter knows it,
      else None.
    - `friction`: mu in q = mu p; None leaves p and q apart.
    - `centred` (c,): whether only the deviation from the mean is solved for: where the mean is
      known from outside, and where the signal is blind to it.

    Raises `BadInput` where shapes disagree, fewer than three samples are there, the noise is zero,
    or one element is asked for p and q apart.
    """

    line: Line
    forward: Convolution
    data: Float[Array, "e n"]
    noise: Float[Array, " k"]
    observed: Bool[Array, "e n"] | None
    known_mean_Pa: tuple[Float[Array, ""] | None, Float[Array, ""] | None]
    friction: Float[Array, ""] | None
    centred: Bool[Array, " c"]

    def __init__(
        self,
        line: Line,
        forward: Convolution,
        data,
        noise,
        *,
        observed=None,
        known_mean_Pa: Sequence[float | Array | None] = (None, None),
        friction=None,
    ):
        data = as_real(data)
        elements = forward.transfer.shape[0]
        refuse(
            data.shape != (elements, line.n),
            f"The data have shape {data.shape}: the model expects (element, sample) = "
            f"({elements}, {line.n}).",
        )
        seen = line.n if observed is None else int(np.sum(np.any(np.asarray(observed), axis=0)))
        refuse(seen < 3, f"Only {seen} samples are there: an inversion needs at least 3.")
        refuse(
            friction is None and elements < 2,
            "One element cannot tell p from q: give friction (q = mu p) or a second element.",
        )
        noise = as_real(noise)
        refuse(
            not bool(np.all(np.asarray(noise) > 0)),
            "The noise is zero at some wavenumber: give a noise level above 0.",
        )
        if friction is not None:
            friction = as_real(friction)
            transfer = forward.transfer[:, :1] + friction * forward.transfer[:, 1:]
            forward = Convolution(transfer, forward.n, forward.length)
        if observed is not None:
            observed = jnp.asarray(observed)
            observed = None if bool(jnp.all(observed)) else observed
        self.line, self.forward, self.noise = line, forward, noise
        self.data = data if observed is None else jnp.where(observed, data, 0.0)
        self.observed, self.friction = observed, friction
        p_mean, q_mean = (None if mean is None else as_real(mean) for mean in known_mean_Pa)
        self.known_mean_Pa = (p_mean, q_mean)
        self.centred = self._centred()

    @property
    def unknowns(self) -> int:
        """How many components are solved for."""
        return self.forward.transfer.shape[1]

    @property
    def whitener(self) -> Float[Array, " k"]:
        """N^(-1/2) at line.k."""
        return 1 / jnp.sqrt(self.noise)

    @property
    def samples(self) -> int:
        """How many samples are there, over all elements."""
        return int(self.data.size if self.observed is None else np.sum(np.asarray(self.observed)))

    def _centred(self) -> Bool[Array, " c"]:
        known = [mean is not None for mean in self.known_mean_Pa[: self.unknowns]]
        if not self.forward.is_circular:  # the window's ends show a little of the mean
            return jnp.asarray(known)
        informed = jnp.any(self.forward.transfer[..., 0] != 0, axis=0) & jnp.isfinite(self.noise[0])
        return jnp.asarray(known) | ~informed

    def mean_statement(self) -> dict[str, str]:
        """For p and q, in words, where the mean of the estimate comes from."""
        return {name: self._mean_of(c) for c, name in enumerate(COMPONENTS)}

    def _mean_of(self, c: int) -> str:
        known = self.known_mean_Pa[c]
        if known is not None:
            return f"known from outside: {float(known):.6g} Pa"
        if c >= self.unknowns:
            return f"follows from p by q = mu p with mu = {self.friction:.4g}"
        if bool(self.centred[c]):
            return (
                "unobserved: the signal is blind to it, and the estimate is the deviation from it"
            )
        if self.forward.is_circular:
            return "from the signal"
        return "only from what the window's ends show: weakly observed"


class Estimate(eqx.Module):
    """Recovered traction with its uncertainty.

    - `value` (2, n): p and q [Pa]; `stderr` (2, n): posterior standard error [Pa] of the value
      where its mean is in the signal, else of its deviation from the mean (on an open line: over
      the stretch with samples).
    - `covariance`: (c, c, k) per wavenumber on the spectral path, (c n, c n) on the iterative one.
    - `result`: "converged", or what did not work; `stats`: numbers of the solution (iterations,
      weights, degrees of freedom).
    - `fitted` (e, n): the signal explained; `whitened` (e, n): residual over the noise, NaN where
      no sample is.
    - `averaging` (c, c, n): the estimate's response to a unit traction in the middle cell; the
      transform of its diagonal is the resolution at each wavenumber.
    """

    value: Float[Array, "2 n"]
    stderr: Float[Array, "2 n"]
    covariance: Complex[Array, "c c k"] | Float[Array, "m m"]
    fitted: Float[Array, "e n"]
    whitened: Float[Array, "e n"]
    averaging: Float[Array, "c c n"]
    result: str = eqx.field(static=True)
    stats: dict[str, Any] = eqx.field(static=True)

    def with_stats(self, stats: dict[str, Any]) -> "Estimate":
        """The same estimate, saying more about how it was made."""
        return dataclasses.replace(self, stats=stats | self.stats)
