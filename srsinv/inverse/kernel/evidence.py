"""The posterior of kernels under their Gaussian process, and the evidence of what it goes by.

With the kernels' coefficients a = r b, b normal of variance one, r the prior's standard deviations,
beside c signals of physical parameters t, normal of variance one, too:

    y = A r b + J t + noise,    M = A^T R^-1 A,    H = 1 + r M r.

The log evidence is -log|H|/2 - log|T|/2 + (|L^-1 r A^T R^-1 y|^2 + t^T T t)/2 + const, with L L^T =
H and T the precision of t once b is integrated out (Rasmussen and Williams 2006, section 2.7).
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from ...numerics import ROUNDED, root_of

LEAST_WAVE = 1e-9  # of the longest one: shorter waves are left out, as denormal numbers are slow
# Of a sum of squares r M r, at most, beside the prior's one: of more, rounding leaves nothing of
# that one among some hundred waves, and the evidence of so large a scale would be rounding.
MOST_SEEN = 1e-3 / float(np.finfo(float).eps)
UNSEEN = 1e-3  # r M r of waves that a search leaves out: the evidence has as little of them
MOST_STEPS = 40
TOLERANCE = 0.15  # of the log evidence's slope, in standard errors: some 0.01 are left
FIRST_STEP = 10.0  # standard errors


class Products(NamedTuple):
    """Of the signals A (2 b, .) of the waves of p and q under one envelope, J (c, .) and the data y
    of one element, all weighed: A R^-1 A^T and so on."""

    waves: Float[np.ndarray, "a a"]
    data: Float[np.ndarray, " a"]
    both: Float[np.ndarray, "a c"]
    physics: Float[np.ndarray, "c c"]
    physics_data: Float[np.ndarray, " c"]
    square: float

    def scaled(self, factors: Float[np.ndarray, " c"]) -> "Products":
        """The same with the signals J times these factors."""
        return self._replace(
            both=self.both * factors,
            physics=self.physics * np.outer(factors, factors),
            physics_data=self.physics_data * factors,
        )


class KernelEnvelope(NamedTuple):
    """Its width w [m], and the part that is left of it far from the load."""

    width_m: float
    far: float


class KernelPrior(NamedTuple):
    """The kernels' standard deviation at a lag of zero [C m/N], of p and of q of each element
    (e, 2), the length l [m] and the envelope."""

    scale: Float[np.ndarray, "e 2"]
    length_m: float
    envelope: "KernelEnvelope"

    def deviations(self, element: int, k: Float[np.ndarray, " b"]) -> Float[np.ndarray, " a"]:
        """r, of the waves of p and then those of q."""
        fall = np.exp(-k * self.length_m)
        fall = np.where(fall > LEAST_WAVE, fall, 0.0)
        fall /= np.sqrt((fall[0] ** 2 + np.sum(fall**2)) / 2)  # a cosine and a sine make one
        return np.concatenate([scale * fall for scale in self.scale[element]])

    def length_slope(self, k: Float[np.ndarray, " b"]) -> Float[np.ndarray, " b"]:
        """d log r / d log l of the waves of p, and of q."""
        power = np.exp(-2 * k * self.length_m)
        return self.length_m * (np.sum(k * power) / (power[0] + np.sum(power)) - k)


class ElementPosterior(NamedTuple):
    """Coefficients of one element given t: L, L^-1 r A^T R^-1 y, and the same of J, of those that
    are `used`."""

    root: Float[np.ndarray, "o o"]
    data: Float[np.ndarray, " o"]
    both: Float[np.ndarray, "o c"]
    deviations: Float[np.ndarray, " a"]
    used: Int[np.ndarray, " o"]

    def coefficients(self, t: Float[np.ndarray, " c"]) -> Float[np.ndarray, " a"]:
        """Their mean."""
        return self._placed((self.data - self.both @ t)[:, None])[:, 0]

    @property
    def slope(self) -> Float[np.ndarray, "a c"]:
        """What they change by with t."""
        return -self._placed(self.both)

    @property
    def factor(self) -> Float[np.ndarray, "a o"]:
        """F of their covariance F F^T, given t."""
        return self._placed(np.eye(len(self.root)))

    def _placed(self, right: Float[np.ndarray, "o i"]) -> Float[np.ndarray, "a i"]:
        whole = np.zeros((self.deviations.size, right.shape[1]))
        whole[self.used] = self.deviations[self.used, None] * _solved(self.root, right, True)
        return whole


class KernelPosterior(NamedTuple):
    """Parameters t (c,) with their covariance, the coefficients of each element, and the log
    evidence."""

    t: Float[np.ndarray, " c"]
    covariance: Float[np.ndarray, "c c"]
    elements: Sequence[ElementPosterior]
    log_evidence: float

    def of(self, parameters: slice) -> "KernelPosterior":
        """That of these parameters, which the others have nothing to do with."""
        elements = [each._replace(both=each.both[:, parameters]) for each in self.elements]
        covariance = self.covariance[parameters, parameters]
        return self._replace(t=self.t[parameters], covariance=covariance, elements=elements)

    def chi2(self, products: Sequence[Products]) -> float:
        """The square of what the mean leaves of the data, weighed."""
        t, squares = self.t, 0.0
        for own, given in zip(products, self.elements, strict=True):
            b = given.coefficients(t)
            squares += own.square + b @ own.waves @ b + 2 * b @ own.both @ t + t @ own.physics @ t
            squares -= 2 * (own.data @ b + own.physics_data @ t)
        return max(float(squares), 0.0)

    def slopes(self, e: int) -> tuple[Float[np.ndarray, " o"], Float[np.ndarray, "o o"]]:
        """The log evidence's slope by log r of the coefficients of element e that are used,
        E[b^2] - 1, and its curvature as expected, 2 (1 - cov b)^2 by entries."""
        own = self.elements[e]
        if not own.used.size:
            return np.zeros(0), np.zeros((0, 0))
        mean = _solved(own.root, own.data - own.both @ self.t, True)
        slope = _solved(own.root, own.both @ root_of(self.covariance), True)
        lower, _ = scipy.linalg.lapack.dpotri(own.root, lower=1)
        covariance = lower + lower.T + slope @ slope.T
        covariance.flat[:: mean.size + 1] -= np.diag(lower)
        slope = mean**2 + np.diag(covariance) - 1
        covariance.flat[:: mean.size + 1] -= 1.0
        return slope, 2 * covariance**2

    @property
    def resolved_dof(self) -> float:
        """Effective degrees of freedom: how many of t and b the data determine, one less the
        posterior's over the prior's variance for each."""
        total = self.t.size - np.trace(self.covariance)
        for own in self.elements:
            size = len(own.root)
            slope = _solved(own.root, own.both, True)
            spread = np.sum(_solved(own.root, np.eye(size)) ** 2)
            total += size - spread - np.sum((slope @ self.covariance) * slope)
        return float(total)


def posterior(
    products: Sequence[Products],
    prior: KernelPrior,
    k: Float[np.ndarray, " b"],
    t0: np.ndarray,
    unseen: float = 0.0,
) -> KernelPosterior:
    """The posterior under a prior; t is normal about -`t0`. Waves with r M r up to `unseen` are
    left out."""
    precision, right, log, given = np.eye(t0.size), -t0, 0.0, []
    for e, own in enumerate(products):
        every = prior.deviations(e, k)
        used = np.flatnonzero(every**2 * np.diag(own.waves) > unseen if unseen else every)
        r = every[used]
        matrix = r[:, None] * own.waves[np.ix_(used, used)] * r
        matrix.flat[:: r.size + 1] += 1.0 + ROUNDED * np.trace(matrix)
        root = scipy.linalg.cholesky(matrix, lower=True, check_finite=False)
        sides = np.column_stack([own.data, own.both])[used]
        solved = _solved(root, r[:, None] * sides)
        data, both = solved[:, 0], solved[:, 1:]
        rounded = ROUNDED * np.diag(np.diag(own.physics))
        precision = precision + own.physics - both.T @ both + rounded
        right = right + own.physics_data - both.T @ data
        log += (data @ data - own.square) / 2 - np.sum(np.log(np.diag(root)))
        given.append(ElementPosterior(root, data, both, every, used))
    covariance = np.linalg.inv(precision) if t0.size else precision
    t = covariance @ right
    log += (right @ t - t0 @ t0 + (np.linalg.slogdet(covariance)[1] if t0.size else 0.0)) / 2
    return KernelPosterior(t, covariance, given, float(log))


def likeliest(
    products: Sequence[Products],
    first: KernelPrior,
    k: Float[np.ndarray, " b"],
    t0: np.ndarray,
    shared: bool,
) -> tuple[KernelPrior, float]:
    """The prior with the greatest evidence under its envelope, and that.

    `shared`: one factor on all scales of `first`; else one on each.
    """
    shape = (1, 1) if shared else first.scale.shape
    count = int(np.prod(shape))

    def prior_at(logs: Float[np.ndarray, " c"]) -> KernelPrior:
        factors = np.exp(logs[:-1]).reshape(shape)
        return first._replace(
            scale=first.scale * factors, length_m=float(first.length_m * np.exp(logs[-1]))
        )

    @lru_cache(maxsize=2)
    def at(logs: tuple[float, ...]) -> tuple[float, np.ndarray, np.ndarray]:
        """The loss, its slope, and its curvature as expected."""
        prior = prior_at(np.array(logs))
        if not _is_resolved(products, prior, k):
            return np.inf, np.zeros(count + 1), np.eye(count + 1)
        found = posterior(products, prior, k, t0, UNSEEN)
        slope, curvature = np.zeros(count + 1), np.zeros((count + 1, count + 1))
        for e, given in enumerate(found.elements):
            own, among = found.slopes(e)
            by_logs = np.zeros((2 * k.size, count + 1))
            for c, rows in enumerate((slice(0, k.size), slice(k.size, None))):
                by_logs[rows, 0 if shared else 2 * e + c] = 1.0
                by_logs[rows, -1] = prior.length_slope(k)
            by_logs = by_logs[given.used]
            slope += own @ by_logs
            curvature += by_logs.T @ among @ by_logs
        return -found.log_evidence, -slope, curvature

    # In units of standard errors of the logarithms a slope tells how much evidence is left.
    start = at((0.0,) * (count + 1))[2] + np.eye(count + 1)
    units = np.linalg.inv(np.linalg.cholesky(start)).T
    found = scipy.optimize.minimize(
        lambda x: at(tuple(units @ x))[0],
        np.zeros(count + 1),
        jac=lambda x: units.T @ at(tuple(units @ x))[1],
        hess=lambda x: units.T @ at(tuple(units @ x))[2] @ units,
        method="trust-exact",
        options={"gtol": TOLERANCE, "maxiter": MOST_STEPS, "initial_trust_radius": FIRST_STEP},
    )
    return prior_at(units @ found.x), -float(found.fun)


def _is_resolved(
    products: Sequence[Products], prior: KernelPrior, k: Float[np.ndarray, " b"]
) -> bool:
    """Whether the prior is not so wide that rounding decides on its posterior."""
    seen = [
        np.sum(prior.deviations(e, k) ** 2 * np.diag(own.waves)) for e, own in enumerate(products)
    ]
    return bool(max(seen) <= MOST_SEEN)


def _solved(root: np.ndarray, right: np.ndarray, transposed: bool = False) -> np.ndarray:
    return scipy.linalg.solve_triangular(
        root, right, lower=True, trans=int(transposed), check_finite=False
    )
