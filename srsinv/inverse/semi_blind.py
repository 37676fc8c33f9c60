"""Semi-blind inversion: depth, gain ratio and angle found together with the traction, from the
recording of an unknown surface.

Facts of the rig that nobody measured are found by the evidence, with the traction integrated out
(rig/stationary.py). The traction is then that of another method under the facts found, with their
errors in its bands. A fact that the signals do not determine is reported as not identifiable, and
taken as stated.
"""

import dataclasses
from typing import Any

import equinox as eqx
import numpy as np

from ..errors import BadInput, check_name, echo, of_kind, refuse
from ..grid import Periodic
from ..known import is_traced
from ..modules import with_fields
from ..quantities import quantity
from .estimate import Estimate
from .line.problem import LineProblem
from .method import Method
from .problem import Problem
from .rig.found import FoundFacts
from .rig.setup import number_of_films
from .rig.stationary import DEPTH
from .wiener import TractionSpectrum, Wiener

UNKNOWN = ("depth_m", "gain", "angle_deg")


class SemiBlind(Method):
    """The inversion of a sensor whose depth, gain ratio and angle are not known.

    - `unknown`: names of what is found, of "depth_m" (common to all elements), "gain" and
      "angle_deg" (of each later element beside the first, whose own are taken as stated, as they
      go with the traction's level). What is stated of them is where the search is, from 0.3 to 3.3
      times the depth, and no prior. Other facts keep their tolerances. One element has a depth
      alone.
    - `method`: the inversion under the facts found; None: Wiener's filter, whose levels of p and q
      are those under which the data are most likely.

    The estimate has `parameters` `depth_m`, `gain_ratio_2` (of element 2 over element 1, 1 as
    stated) and `angle_2_deg`, and `log_evidence` among its `stats`. Where the standard error of a
    fact is above 10 % (of an angle 6 degrees), or two values are as probable, it is not
    identifiable: a warning says so, and the inversion takes it as stated.

    Raises `BadInput` for other names, for a problem without a sensor, under `jax.jit` or in single
    precision, and for a sensor whose response does not change with an unknown.
    """

    unknown: tuple[str, ...] = eqx.field(static=True)
    method: Method

    def __init__(self, unknown: Any = UNKNOWN, method: Any = None):
        names = list(unknown) if isinstance(unknown, list | tuple) else []
        refuse(
            not names,
            f"method.semi_blind.unknown is {echo(unknown)}: give a list of {', '.join(UNKNOWN)}.",
        )
        for name in names:
            check_name("method.semi_blind.unknown", name, UNKNOWN)
        self.unknown = tuple(dict.fromkeys(names))
        inner = Wiener(scale="evidence") if method is None else method
        wanted = "a method, such as srsinv.Tikhonov()"
        self.method = of_kind("method.semi_blind.method", inner, Method, wanted)

    def __call__(self, problem: Problem | LineProblem) -> Estimate:
        """The estimate of p and q under the facts found, with these as its parameters."""
        problem = _with_sensor(problem)
        names = self.names(problem)
        found = first = FoundFacts.of(problem, names)
        while found.names and found.lost:
            found = found.without(found.lost)
        estimate = self.method(found.problem if found.names else problem)
        lost = [name for name in names if name not in found.names]
        warnings = (_not_identifiable(name, first) for name in lost)
        return dataclasses.replace(
            estimate,
            parameters={**estimate.parameters, **first.parameters, **found.parameters},
            stats={**estimate.stats, "log_evidence": first.log_evidence},
            warnings=(*estimate.warnings, *warnings),
        )

    def expected_stderr(
        self, problem: Problem | LineProblem, p: TractionSpectrum, q: TractionSpectrum | None = None
    ) -> dict[str, float]:
        """The Cramer-Rao bound of the unknown facts: their standard errors, by the names of the
        estimate's `parameters`, before anything is measured.

        Of the problem its sensor, scan, noise, rig and friction count, and not the signals. The
        traction has the spectra `p` and `q`, as `srsinv.inverse.wiener.Exponential(rms_Pa,
        correlation_m)`; None: q as p.
        """
        problem = _with_sensor(problem)
        model = FoundFacts.model_of(problem, self.names(problem))
        line = Periodic(2 * (model.k.size - 1), float(model.step_m))
        fine = with_fields(problem.to_grid(), line=line)
        each = [p, p if q is None else q][: problem.unknowns]
        power = np.stack([np.asarray(one.power(fine)) for one in each]) * float(model.step_m)
        bound = FoundFacts.at(problem, model, model.with_spectra(power)).parameters
        return {name: stderr for name, (_, stderr) in bound.items()}

    def names(self, problem: LineProblem) -> tuple[str, ...]:
        """The unknown facts of a problem's sensor, one for each element that has one."""
        assert problem.sensor is not None
        later = range(2, number_of_films(problem.sensor) + 1)
        each = {
            "depth_m": [DEPTH],
            "gain": [f"gain_{n}" for n in later],
            "angle_deg": [f"angle_{n}_deg" for n in later],
        }
        names = tuple(name for kind in UNKNOWN if kind in self.unknown for name in each[kind])
        refuse(
            not names,
            f"method.semi_blind.unknown is {echo(list(self.unknown))}, but one element has no gain "
            "or angle beside another's: give [depth_m].",
        )
        return names


def _with_sensor(problem: Problem | LineProblem) -> LineProblem:
    on = problem if isinstance(problem, LineProblem) else problem.to_grid()
    if on.sensor is None or on.scan is None:
        raise BadInput(
            "The problem has an operator but no sensor, whose depth could be found: give sensor "
            "and scan."
        )
    refuse(
        is_traced(on),
        "SemiBlind searches for facts of known signals: call it outside jax.jit, jax.grad and "
        "jax.vmap.",
    )
    refuse(
        on.data.dtype != np.float64,
        "SemiBlind needs double precision, as signals decay by exp(-kz): give precision=float64.",
    )
    return on


def _not_identifiable(name: str, found: FoundFacts) -> str:
    """The warning on a fact that the signals do not determine."""
    key, value, stderr = found.reported(name)
    what = key.removesuffix("_m").removesuffix("_deg").replace("_", " ")
    unit = "m" if key.endswith("_m") else ""
    degrees = " degrees" if key.endswith("_deg") else ""
    size = quantity(stderr, unit) if unit else f"{stderr:.2g}"
    best = quantity(value, unit) if unit else f"{value:.3g}"
    return (
        f"The {what} is not identifiable from this recording: the most probable value is {best} "
        f"with a standard error of {size}{degrees}. The inversion takes it as stated, with its "
        "tolerance. Measure it, give friction=MU if q = mu p, or add an element at another angle."
    )
