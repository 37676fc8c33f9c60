"""The posterior of kernels under their Gaussian process, and the evidence of what it goes by.

With the kernels' coefficients a = r b, b normal of variance one, r the prior's standard deviations,
beside c signals of physical parameters t, normal of variance one, too:

    y = A r b + J t + noise,    M = A^T R^-1 A,    H = 1 + r M r.

The log evidence is -log|H|/2 - log|T|/2 + (|L^-1 r A^T R^-1 y|^2 + t^T T t)/2 + const, with L L^T =
H and T the precision of t once b is integrated out (Rasmussen and Williams 2006, section 2.7).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

WIDTHS = 0.5, 1.0, 2.0, 4.0  # depths that are tried for the envelope's width,
FAR_PARTS = 0.03, 1.0  # and what is tried to be left of it far from the load
LOG_TIMES = np.log(1e4)  # by which a scale may differ from its first guess,
LOG_LENGTHS = -np.log(10.0), np.log(10.0)  # and the length
LEAST_WAVE = 1e-9  # of the longest one: shorter waves are left out, as denormal numbers are slow
STEPS_EACH = 40  # evaluations for each number that is sought
TOLERANCE = 0.02  # of the logarithms, and 0.05 of the log evidence: no band shows it


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


class Envelope(NamedTuple):
    """Its width w [m], and the part that is left of it far from the load."""

    width_m: float
    far: float

    @classmethod
    def all_of(cls, depth_m: float) -> list["Envelope"]:
        """Those that are tried, at a film's depth."""
        return [cls(each * depth_m, far) for far in FAR_PARTS for each in WIDTHS]


class Prior(NamedTuple):
    """The kernels' standard deviation at a lag of zero [C m/N], of p and of q of each element
    (e, 2), the length l [m] and the envelope."""

    scale: Float[np.ndarray, "e 2"]
    length_m: float
    envelope: "Envelope"

    def deviations(self, element: int, k: Float[np.ndarray, " b"]) -> Float[np.ndarray, " a"]:
        """r, of the waves of p and then those of q."""
        fall = np.exp(-k * self.length_m)
        fall = np.where(fall > LEAST_WAVE, fall, 0.0)
        fall /= np.sqrt((fall[0] ** 2 + np.sum(fall**2)) / 2)  # a cosine and a sine make one
        return np.concatenate([scale * fall for scale in self.scale[element]])


class Given(NamedTuple):
    """Coefficients of one element given t: L, L^-1 r A^T R^-1 y, and the same of J, of those whose
    r is not zero."""

    root: Float[np.ndarray, "o o"]
    data: Float[np.ndarray, " o"]
    both: Float[np.ndarray, "o c"]
    deviations: Float[np.ndarray, " a"]

    def coefficients(self, t: Float[np.ndarray, " c"]) -> Float[np.ndarray, " a"]:
        """Their mean."""
        return self._placed((self.data - self.both @ t)[:, None])[:, 0]

    @property
    def moved(self) -> Float[np.ndarray, "a c"]:
        """What they change by with t."""
        return -self._placed(self.both)

    @property
    def factor(self) -> Float[np.ndarray, "a o"]:
        """F of their covariance F F^T, given t."""
        return self._placed(np.eye(len(self.root)))

    def _placed(self, right: Float[np.ndarray, "o i"]) -> Float[np.ndarray, "a i"]:
        whole = np.zeros((self.deviations.size, right.shape[1]))
        used = self.deviations > 0
        whole[used] = self.deviations[used, None] * _solved(self.root, right, True)
        return whole


class Posterior(NamedTuple):
    """Parameters t (c,) with their covariance, the coefficients of each element, and the log
    evidence."""

    t: Float[np.ndarray, " c"]
    covariance: Float[np.ndarray, "c c"]
    elements: Sequence[Given]
    log_evidence: float

    def of(self, parameters: slice) -> "Posterior":
        """That of these parameters, which the others have nothing to do with."""
        elements = [each._replace(both=each.both[:, parameters]) for each in self.elements]
        covariance = self.covariance[parameters, parameters]
        return self._replace(t=self.t[parameters], covariance=covariance, elements=elements)

    @property
    def resolved_dof(self) -> float:
        """Effective degrees of freedom: how many of t and b the data determine, one less the
        posterior's over the prior's variance for each."""
        total = self.t.size - np.trace(self.covariance)
        for own in self.elements:
            size = len(own.root)
            moved = _solved(own.root, own.both, True)
            spread = np.sum(_solved(own.root, np.eye(size)) ** 2)
            total += size - spread - np.sum((moved @ self.covariance) * moved)
        return float(total)


def posterior(
    products: Sequence[Products], prior: Prior, k: Float[np.ndarray, " b"], t0: np.ndarray
) -> Posterior:
    """The posterior under a prior; t is normal about -`t0`."""
    precision, right, log, given = np.eye(t0.size), -t0, 0.0, []
    for e, own in enumerate(products):
        every = prior.deviations(e, k)
        used = np.flatnonzero(every)
        r = every[used]
        matrix = r[:, None] * own.waves[np.ix_(used, used)] * r
        matrix.flat[:: r.size + 1] += 1.0
        root = scipy.linalg.cholesky(matrix, lower=True, check_finite=False)
        sides = np.column_stack([own.data, own.both])[used]
        solved = _solved(root, r[:, None] * sides)
        data, both = solved[:, 0], solved[:, 1:]
        precision = precision + own.physics - both.T @ both
        right = right + own.physics_data - both.T @ data
        log += (data @ data - own.square) / 2 - np.sum(np.log(np.diag(root)))
        given.append(Given(root, data, both, every))
    covariance = np.linalg.inv(precision) if t0.size else precision
    t = covariance @ right
    log += (right @ t - t0 @ t0 + (np.linalg.slogdet(covariance)[1] if t0.size else 0.0)) / 2
    return Posterior(t, covariance, given, float(log))


def likeliest(
    products: Sequence[Products],
    first: Prior,
    k: Float[np.ndarray, " b"],
    t0: np.ndarray,
    shared: bool,
    steps_each: int | None = None,
) -> tuple[Prior, float]:
    """The prior with the greatest evidence under its envelope, and that.

    `shared`: one factor on all scales of `first`; else one on each. `steps_each`: evaluations for
    each number, None: as many as any start may need.
    """
    shape = (1, 1) if shared else first.scale.shape

    def prior_at(logs: np.ndarray) -> Prior:
        factors = np.exp(logs[:-1]).reshape(shape)
        return first._replace(
            scale=first.scale * factors, length_m=float(first.length_m * np.exp(logs[-1]))
        )

    def loss(logs: np.ndarray) -> float:
        try:
            return -posterior(products, prior_at(logs), k, t0).log_evidence
        except np.linalg.LinAlgError:  # a scale so large that rounding decides
            return np.inf

    count = int(np.prod(shape)) + 1
    found = scipy.optimize.minimize(
        loss,
        np.zeros(count),
        method="Nelder-Mead",
        bounds=[(-LOG_TIMES, LOG_TIMES)] * (count - 1) + [LOG_LENGTHS],
        options={"xatol": TOLERANCE, "fatol": 0.05, "maxfev": (steps_each or STEPS_EACH) * count,
                 "initial_simplex": _simplex(count, 0.3 if steps_each else 1.0)},
    )  # fmt: skip
    return prior_at(found.x), -float(found.fun)


def _simplex(count: int, size: float) -> Float[np.ndarray, "v c"]:
    return size * np.concatenate([np.zeros((1, count)), np.diag([1.0] * (count - 1) + [0.4])])


def _solved(root: np.ndarray, right: np.ndarray, transposed: bool = False) -> np.ndarray:
    return scipy.linalg.solve_triangular(
        root, right, lower=True, trans=int(transposed), check_finite=False
    )
