"""The contract of every inversion: a problem to an estimate."""

import abc

import equinox as eqx

from .problem import Estimate, Problem


class Method(eqx.Module):
    """An inversion. Its fields are its settings; a call solves one problem."""

    @abc.abstractmethod
    def __call__(self, problem: Problem) -> Estimate:
        """The estimate of p and q [Pa] on the problem's line, with its standard error."""
