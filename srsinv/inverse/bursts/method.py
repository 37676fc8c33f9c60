"""Inversion of a pass with bursts of catch and snap: the traction that all elements share, and the
bursts that the skin makes, by the evidence."""

from typing import Any

import equinox as eqx
import numpy as np

from ...errors import BadInput, echo, number, of_kind, refuse
from ...known import is_traced
from ..estimate import Estimate
from ..line.problem import LineProblem
from ..method import Method
from ..problem import Problem
from ..wiener import Wiener
from .burst_pass import BurstPass
from .model import BurstModel, are_usual, samples_in_a_cell
from .posterior import Burst

ROUNDS = 4  # of levels and bursts in turn, at most
MOST_UNUSUAL = 0.1  # of the samples are in cells of other noise, at a constant speed


class BurstInversion(Method):
    """The traction and the bursts of catch and snap, found together from elements along the travel.

    All elements see the same surface, and record the same bursts, each through its own response.
    The evidence says which part of the signals is a burst: at most 2 % of passes without any have
    one claimed. Where they crowd as the model of the traction is wrong, none is claimed. The
    estimate is a [`BurstEstimate`][], whose `bursts` have time, place on the finger, size and
    decay, with standard errors and 90 % intervals, and the rate of bursts. Three elements locate a
    burst; with one, and often with two, its place is ambiguous.

    - `patch_m` [m]: length of the patch of skin that snaps back; `contact_m` [m]: of the contact
      about the sensor's origin, over which places are of equal odds.
    - `decay_s` [s]: shortest and longest decay of a burst, of equal odds over logarithms.
    - `method`: the inversion of what is left, which has a Gaussian prior; None: Wiener's filter,
      whose levels of p and q are those under which the data are most likely.

    Raises `BadInput` for lengths and decays that are not positive, for a problem without a sensor,
    at rest, of several passes or of a speed that varies, with so many samples missing that they
    exceed the memory, and under `jax.jit`.
    """

    patch_m: float = eqx.field(static=True)
    contact_m: float = eqx.field(static=True)
    decay_s: tuple[float, float] = eqx.field(static=True)
    method: Method

    def __init__(
        self, patch_m: Any = 0.5e-3, contact_m: Any = 10e-3, decay_s: Any = (1e-3, 20e-3),
        method: Any = None,
    ):  # fmt: skip
        key, wanted = "method.bursts.", "a positive length in metres"
        self.patch_m = float(number(f"{key}patch_m", patch_m, wanted, above=0))
        self.contact_m = float(number(f"{key}contact_m", contact_m, wanted, above=0))
        pair = list(decay_s) if isinstance(decay_s, list | tuple | np.ndarray) else []
        what = "two positive times in seconds, the shorter one first"
        refuse(len(pair) != 2, f"{key}decay_s is {echo(decay_s)}: give {what}.")
        low, high = (float(number(f"{key}decay_s", each, what, above=0)) for each in pair)
        refuse(low >= high, f"{key}decay_s is {echo(decay_s)}: give {what}.")
        self.decay_s = low, high
        inner = Wiener(scale="evidence") if method is None else method
        wanted = "a method, such as srsinv.Wiener()"
        self.method = of_kind(f"{key}method", inner, Method, wanted)

    def __call__(self, problem: Problem | LineProblem) -> Estimate:
        """The estimate of p and q and of the bursts."""
        problem = checked(problem)
        model = BurstModel(problem, self.patch_m, self.contact_m, self.decay_s)
        parts = BurstPass(problem, model, self.method)
        bursts: list[Burst] = []
        for _ in range(ROUNDS):
            parts.set_levels(bursts)
            before, bursts = bursts, parts.search.run(bursts)
            if parts.search.are_model_errors(bursts):
                return parts.without_claims()
            if [each.sample for each in before] == [each.sample for each in bursts]:
                break
        return parts.estimate(bursts)

    @property
    def chooses_prior(self) -> bool:
        return self.method.chooses_prior


def checked(problem: Problem | LineProblem) -> LineProblem:
    """The problem on its cells, where bursts can be found."""
    on = problem if isinstance(problem, LineProblem) else problem.to_grid()
    if on.sensor is None or on.scan is None:
        raise BadInput(
            "The problem has an operator but no sensor, which bursts need: give sensor and scan."
        )
    refuse(
        is_traced(on),
        "BurstInversion searches known signals: call it outside jax.jit, jax.grad and jax.vmap.",
    )
    refuse(
        not float(on.scan.speed_m_per_s),
        "BurstInversion needs a sensor that slides, as nothing snaps back at rest: give "
        "scan.speed_m_per_s.",
    )
    refuse(
        on.passes is not None,
        "BurstInversion needs a single pass, as no burst comes twice: give the samples of one, by "
        "problem.of_samples(slice(0, 1000)), or recording.ways=onwards where one goes so.",
    )
    lost = on.is_observed & ~are_usual(on)
    refuse(
        int(lost.sum()) > MOST_UNUSUAL * on.sample_count,
        "BurstInversion needs a constant speed, as it takes cells for equal times: give a pass at "
        "constant speed, or recording.speed_m_per_s.",
    )
    refuse(
        on.sensor.amplifier.order == 0 and samples_in_a_cell(on.sensor) > 1,
        "BurstInversion needs cells of one sample where the signal is a charge: give "
        "recording.cell_m, the distance between samples.",
    )
    return on
