"""Facts of a rig that the signals of several elements tell, beside its tolerances.

Under a prior of the traction the elements' signals go together in one way, and a gain, an angle, an
offset or a strip's width of one element beside another changes it. With these facts among the
parameters of Whittle's likelihood (see whittle.py), of mean 0 and covariance one beforehand, the
signals leave them a mean m and a covariance P. Where m is more than chance makes the model is
that of the facts m. An inversion by these facts has the error sum_j c_j f_j, f_j what one standard
deviation of fact j makes of it (see line/rig_bands.py) and c of covariance

    P = P^2 + (P - P^2).

Row j of P is the part that comes from what was stated of fact j, and P - P^2 that of the signals'
noise. Facts as stated, where m may be chance, have the covariance P + m m^T about them. What an
element alone shows of its depth depends on the prior's form, and is not taken.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ... import false_alarm
from ...modules import with_fields
from ..line.problem import LineProblem
from ..rig.error import NOISE, contradiction
from .whittle import CellSignals, Likelihood, SpectralBands, at_bands

LEARNED = ("gain_", "angle_", "offset_", "strip_width_")
LEAST = 1e-6  # of a variance: smaller parts of the noise are left out


def with_learned_facts(problem: LineProblem, depth_m: float, has_walk: bool) -> LineProblem:
    """A problem by the facts of its rig that its signals tell, with the errors that they leave of
    them, and a warning where they contradict a fact that is stated; `has_walk`: whether a drift is
    known to be there. Itself where the rig is exact, and of one element."""
    changes, sources = problem.rig_changes, problem.rig_sources
    learned = np.array([source.startswith(LEARNED) for source in sources], bool)
    signals = CellSignals.of(problem, depth_m)
    if changes is None or not learned.any() or len(problem.data) < 2 or not signals.stretches:
        return problem
    bands = SpectralBands.of(signals)
    rows = np.asarray(changes.transfer, complex)[np.repeat(learned, len(problem.data))]
    transfer = dataclasses.replace(changes, transfer=rows).circulant().transfer
    each = transfer.reshape(-1, *signals.gain.shape) / np.sqrt(signals.white)[:, None, None]
    facts = np.stack([at_bands(one, bands.places) for one in each], axis=2)
    # A correlated part beside them: what that explains as well is no fact.
    likelihood = Likelihood(bands, True, has_walk, facts=facts)
    cost, of = likelihood.greatest()
    as_stated = Likelihood(bands, True, has_walk).greatest()[0]
    mean, left = np.zeros(len(sources)), np.eye(len(sources))
    mean[learned], left[np.ix_(learned, learned)] = of.facts, likelihood.posterior(of)
    if as_stated - cost < scipy.special.chdtri(learned.sum(), false_alarm.NOISE_PART) / 2:
        return _with_errors(problem, mean, left)
    found = contradiction(mean, np.diag(left), sources)
    return with_fields(
        _with_errors(_by_facts(problem, mean), np.zeros(len(mean)), left),
        warnings=(*problem.warnings, *found),
    )


def _by_facts(problem: LineProblem, mean: Float[np.ndarray, " j"]) -> LineProblem:
    """The problem by facts that are so far from what is stated."""
    changes, forward = problem.rig_changes, problem.forward
    assert changes is not None
    each = np.asarray(changes.transfer).reshape(len(mean), *forward.transfer.shape)
    transfer = np.asarray(forward.transfer) + np.einsum("j,j...->...", mean, each)
    return with_fields(
        problem, forward=dataclasses.replace(forward, transfer=jnp.asarray(transfer))
    )


def _with_errors(
    problem: LineProblem, mean: Float[np.ndarray, " j"], left: Float[np.ndarray, "j j"]
) -> LineProblem:
    """The problem with errors of its facts that have this mean and this covariance."""
    sources = problem.rig_sources
    variances, axes = np.linalg.eigh(left - left @ left)
    is_there = variances > LEAST
    of_noise = (axes[:, is_there] * np.sqrt(variances[is_there])).T
    rows, named = np.concatenate([left, of_noise]), [*sources, *[NOISE] * len(of_noise)]
    if mean.any():
        rows = np.concatenate([rows, mean[None]])
        named.append(sources[int(np.argmax(np.abs(mean)))])
    return with_fields(problem, rig_rows=rows, rig_sources=tuple(named))
