"""Signals of no interest beside the noise, of unknown sizes: drift's trend and the waves of mains.

The columns C of each element, scaled so that their sizes are normal of variance one, stand beside
noise of covariance R: the noise of both is R + C C^T, of which Woodbury's identity gives the
inverse. The traction's posterior covariance under R, D, grows by U T^-1 U^T with U = D G^T R^-1 C
and T = 1 + C^T R^-1 (C - G U).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ...grid import as_real
from ...modules import with_fields
from ...numerics import ROUNDED
from ..line.gaps import Gaps
from ..line.problem import LineProblem
from .whitener import NoisePrecision

Signal = Float[np.ndarray, "e n"]
Traction = Float[np.ndarray, "c n"]
Columns = Float[np.ndarray, "e column n"]


class Nuisance:
    """The columns of a problem, which has some, beside its noise."""

    def __init__(self, problem: LineProblem, precision: NoisePrecision | None = None):
        given = np.asarray(problem.nuisance, float)
        self.columns: Columns = np.where(problem.is_observed[:, None], given, 0.0)
        if precision is None:
            precision = NoisePrecision(problem, Gaps.of(problem.is_observed))
        # Elements are independent: one column of each at a time.
        each = [precision(column) for column in self.columns.swapaxes(0, 1)]
        self.weighed = np.stack(each, axis=1)
        self._precision, size = precision, self.columns.shape[1]
        among = np.einsum("ein,ejn->eij", self.columns, self.weighed)
        # Positive definite though rounding of large ones were all that tells two columns apart.
        self.among = np.eye(size) + among * (1 + ROUNDED * np.eye(size))

    def sizes(self, residual: Signal) -> Float[np.ndarray, "e column"]:
        """The expected sizes in what a traction leaves of the signal."""
        products = np.einsum("ein,en->ei", self.weighed, residual)
        return np.linalg.solve(self.among, products[..., None])[..., 0]

    @property
    def dof(self) -> float:
        """The degrees of freedom that the columns take."""
        return float(
            self.among.shape[0] * self.among.shape[1]
            - np.sum(np.trace(np.linalg.inv(self.among), axis1=1, axis2=2))
        )

    def signal(self, residual: Signal) -> Signal:
        """The expected signal of the columns in what a traction leaves."""
        return np.einsum("ei,ein->en", self.sizes(residual), self.columns)

    def weigh(self, y: Signal) -> Signal:
        """(R + C C^T)^-1 y."""
        return self._precision(y) - np.einsum("ei,ein->en", self.sizes(y), self.weighed)


class WithoutNuisance(NamedTuple):
    """A problem without its columns: their expected `signal` (e, n) is taken out of its data, with
    the degrees of freedom that they take."""

    problem: LineProblem
    signal: Float[Any, "e n"]
    dof: float

    @classmethod
    def of(
        cls, problem: LineProblem, traction: Float[Any, "c n"] | None = None
    ) -> "WithoutNuisance":
        """The problem less what is expected of its columns beside the signal of a traction; None:
        of none."""
        if problem.nuisance is None:
            return cls(problem, np.zeros(problem.data.shape), 0.0)
        data, nuisance = np.asarray(problem.data, float), Nuisance(problem)
        fitted = 0.0 if traction is None else np.asarray(problem.forward(jnp.asarray(traction)))
        signal = nuisance.signal(data - fitted)
        left = as_real(np.where(problem.is_observed, data - signal, 0.0))
        return cls(with_fields(problem, data=left, nuisance=None), as_real(signal), nuisance.dof)


def scored(problem: LineProblem, traction: Float[Any, "c n"] | None = None) -> LineProblem:
    """The problem that a rule scores in place of one with columns: without them, and its data less
    sizes drawn from what is known of them beside the signal of a traction; None: of none.

    Data less the expected sizes would have no noise along the columns, which a rule takes for a
    signal that is fitted there; less drawn ones they have the same noise along all.
    """
    if problem.nuisance is None:
        return problem
    data, nuisance = np.asarray(problem.data, float), Nuisance(problem)
    normal = np.random.default_rng(0).normal(size=nuisance.among.shape[:2])
    roots = np.linalg.cholesky(nuisance.among).swapaxes(1, 2)
    fitted = 0.0 if traction is None else np.asarray(problem.forward(jnp.asarray(traction)))
    drawn = nuisance.sizes(data - fitted) + np.linalg.solve(roots, normal[..., None])[..., 0]
    signal = np.einsum("ei,ein->en", drawn, nuisance.columns)
    left = np.where(problem.is_observed, data - signal, 0.0)
    return with_fields(problem, data=as_real(left), nuisance=None)


class NuisanceCorrection(NamedTuple):
    """What the columns change of a posterior: `solutions` U (m, c, n), `images` G^T R^-1 C
    (m, c, n) and the inverse of T (m, m), for all columns of all elements in a row."""

    solutions: Float[np.ndarray, "m c n"]
    images: Float[np.ndarray, "m c n"]
    inverse: Float[np.ndarray, "m m"]

    @classmethod
    def of(
        cls,
        nuisance: Nuisance,
        adjoint: Callable[[Signal], Traction],
        solve: Callable[[Traction], Traction],
    ) -> "NuisanceCorrection":
        """`adjoint` is G^T, and `solve` the posterior covariance without the columns."""
        images = []
        for e, rows in enumerate(nuisance.weighed):
            for row in rows:
                alone = np.zeros((len(nuisance.weighed), row.size))
                alone[e] = row
                images.append(adjoint(alone))
        images = np.stack(images)
        solutions = np.stack([solve(image) for image in images])
        among = scipy.linalg.block_diag(*nuisance.among)
        tight = among - np.einsum("icn,jcn->ij", images, solutions)
        # In exact numbers at least one everywhere; what is lost of a large difference is rounding.
        tight = tight + ROUNDED * np.diag(np.diag(among))
        return cls(solutions, images, np.linalg.inv((tight + tight.T) / 2))

    def corrected(self, solved: Traction) -> Traction:
        """The solution beside the columns, from that without them of the same right side."""
        products = np.einsum("icn,cn->i", self.images, solved)
        return solved + np.einsum("i,icn->cn", self.inverse @ products, self.solutions)

    def variance(self, mean_weights: Float[np.ndarray, "c n"]) -> Traction:
        """What is added to the variance of the traction, less its mean with these weights."""
        of_mean = np.einsum("icn,cn->ic", self.solutions, mean_weights)
        solutions = self.solutions - of_mean[..., None]
        return np.einsum("icn,ij,jcn->cn", solutions, self.inverse, solutions)
