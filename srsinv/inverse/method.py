"""The contract of every inversion: a problem to an estimate."""

import abc

import equinox as eqx

from .estimate import Estimate
from .line_problem import LineProblem
from .problem import Problem


class Method(eqx.Module):
    """An inversion. Its fields are its settings; a call solves one problem.

    The method chooses its line: it takes the problem's signals on cells (`problem.on_line()`), or
    as they were sampled (`problem.samples()`), and the estimate says on which line it is.
    """

    @abc.abstractmethod
    def __call__(self, problem: Problem | LineProblem) -> Estimate:
        """The estimate of p and q [Pa], with its standard error."""
