"""The contract of every inversion: a problem to an estimate."""

import abc
from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float

from ..errors import BadInput
from .estimate import Estimate
from .line.prior import Prior
from .line.problem import LineProblem
from .problem import Problem


class Method(eqx.Module):
    """Base of methods: an inversion, whose fields are its settings; a call solves one problem.

    The method chooses its line: it takes the problem's signals on cells (`problem.to_grid()`), or
    as they were sampled (`problem.samples()`), and the estimate says on which line it is.
    """

    @abc.abstractmethod
    def __call__(self, problem: Problem | LineProblem) -> Estimate:
        """The estimate of p and q [Pa], with its standard error."""

    def spectra(self, problem: LineProblem) -> Float[Array, "c k"] | None:
        """The power spectra of p and q [Pa^2] that were given; None where none was given."""
        del problem
        return None

    @property
    def chooses_prior(self) -> bool:
        """Whether a rule chooses levels of its prior from a problem's signals."""
        return False

    def prior_fixed_on(self, problem: LineProblem) -> Callable[[LineProblem], Prior]:
        """Its Gaussian prior, with the weights that its rule chooses on `problem`; for any problem.

        Raises `BadInput` for a method without such a prior.
        """
        del problem
        raise BadInput(
            f"{type(self).__name__} has no Gaussian prior, which this job needs: give "
            "method=[wiener,tikhonov] or one of them."
        )
