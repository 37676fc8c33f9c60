"""Whether the credible intervals of estimates and fits are valid: checks that give warnings, as
sentences, or none.

Under the model, the squares of the whitened residual add up to the samples less the numbers that
were fitted, and those of the traction in units of its prior to the numbers fitted of it: both are
chi-square. Bands are valid under the model, and too narrow where these relations fail.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from .. import false_alarm
from ..status import Status
from .quality import is_excess

WRONG_KIND = (
    "Check the kind of the feature, and the stated facts of the sensor, the speed and the "
    "recording."
)
CHECK_SIGNS = (
    "Check the polarity, the sign of the speed, the channels and recording.nominal_pressure_Pa."
)
OR_A_WIDER_PRIOR = "If these are correct, the prior is too narrow, and so is the band."
ALL_OVER = 1.5  # of the mean power of a residual, up to which it is everywhere alike
FEW_DOF = 0.01  # of which the number says no more
LEAST_RESOLVED_DOF = 1.0  # degrees of freedom: with fewer, a component's estimate is its prior
LEAST_EXPLAINED = 0.5  # of a prior's variance: with less, the error is larger than the estimate
# Limit on an inversion's residual, in rms: bands so much too narrow cover 81 % in place of 90 %.
# Its noise and degrees of freedom (a trace over the window) are rougher than a fit's.
OVER_NOISE = 1.25
# Of a mode's variance that its prior's pull has at most, squared, in the mean: R (1 - R) <= 1/4, R
# its resolution.
MOST_PULL = 0.25
# Of a change where it is seen, squared, over the prior's: bands so much too narrow cover 73 %.
MOST_CHANGE = 1.5**2
RESOLVED_GAIN = 0.5  # of a wave's amplitude, from which on it counts as resolved
FEW_MISSING = 0.05  # of the samples
# Bands of the iterative path were 1 to 5 % off in some cells at 0.05, up to 10 % at 0.07, and 40 %
# at 0.1.
MOST_DEFECT = 0.06
# Rms error in standard errors that a band survives: beyond it the band is less than a third of what
# it should be.
MOST_Z = 3.0
MUCH_SLIDING = 0.1  # of the signal's rms: sliding makes less


def prior_alone(
    name: str, resolved_dof: float, cells: int, explained: float = 1.0
) -> Sequence[str]:
    """Warning on a component of which the signal resolves `resolved_dof` degrees of freedom, and
    explains so much of its prior's variance.

    Under the model the estimate's mean square is the explained part of it, and its error's the
    rest.
    """
    if resolved_dof >= LEAST_RESOLVED_DOF and explained >= LEAST_EXPLAINED:
        return ()
    part = f" ({100 * max(explained, 0.0):.0f} % of its prior variance)" if explained < 1 else ""
    return (
        f"The signal resolves {_count(resolved_dof)} of the {cells} degrees of freedom of {name}"
        f"{part}. The estimate and its band are mostly the prior. If q = mu p, give friction=MU; "
        "otherwise add an element or reduce the noise.",
    )


def nothing_resolved(resolved_dof: float, unknowns: int) -> Sequence[str]:
    """Warning on data of a linear problem that resolve `resolved_dof` of its `unknowns`."""
    if resolved_dof >= LEAST_RESOLVED_DOF:
        return ()
    return (
        f"The data resolve {_count(resolved_dof)} of the {unknowns} unknowns. The estimate and its "
        "band are mostly the prior: reduce the noise, or take further data.",
    )


def drawn_bands(draws: int) -> Sequence[str]:
    """Warning on bands that are the scatter of so many draws from the posterior."""
    return (
        f"Bands are those of {draws} draws from the posterior, and right to "
        f"{100 / math.sqrt(2 * draws):.0f} % (one standard deviation). For exact ones, give "
        "path=direct.",
    )


def probed_weight(probes: int, error: float) -> Sequence[str]:
    """Warning on a weight by traces that so many random probes estimate, with the standard
    deviation `error` of its logarithm."""
    if error == 0:
        return ()
    return (
        f"The rule's degrees of freedom are estimated by {probes} random probes, and the weight is "
        f"right to {100 * error:.2g} % (one standard deviation). For an exact one, give "
        "path=direct.",
    )


def shared_out(resolved_dof: float) -> Sequence[str]:
    """Warning on p and q that are observed through one linear combination alone: of the other one
    the signal resolves `resolved_dof` degrees of freedom."""
    if resolved_dof >= LEAST_RESOLVED_DOF:
        return ()
    return (
        "The elements respond to one mix of p and q only: the signal resolves "
        f"{_count(resolved_dof)} degrees of freedom of their difference. The prior divides the mix "
        "between p and q. Give friction=MU, or add an element at another angle.",
    )


def _count(resolved_dof: float) -> str:
    """Degrees of freedom in a sentence."""
    return f"{resolved_dof:.2g}" if resolved_dof >= FEW_DOF else f"less than {FEW_DOF}"


def pulled_by_prior(name: str, pull: float, resolved_dof: float) -> Sequence[str]:
    """Warning on a component whose prior pulls the estimate by more than its band allows.

    `pull`: the mean square of the pull over the mean variance. Under the model its mean is at most
    `MOST_PULL`, and it scatters as a chi-square of `resolved_dof`.
    """
    freedom = max(resolved_dof, LEAST_RESOLVED_DOF)
    if not pull > max(1.0, MOST_PULL * scipy.special.chdtri(freedom, false_alarm.CHECK) / freedom):
        return ()
    return (
        f"The prior shifts {name} by {np.sqrt(pull):.2g} times its standard error, so its band is "
        "too narrow. Use a wider prior: a larger rms, scale=evidence or a smaller weight.",
    )


def negative_pressure(p: np.ndarray, stderr: np.ndarray, resolved_dof: float) -> Sequence[str]:
    """Warning on pressures (cell,) [Pa] below zero by more than chance makes among as many
    independent ones as are resolved."""
    below = np.where(stderr > 0, -p / np.where(stderr > 0, stderr, 1.0), 0.0)
    worst = int(np.argmax(below))
    if not below[worst] > -scipy.special.ndtri(false_alarm.CHECK / max(resolved_dof, 1.0)):
        return ()
    words = _pull_in_words(f"p falls to {1e-3 * p[worst]:.3g} kPa", below[worst])
    return (f"{words} {CHECK_SIGNS} {OR_A_WIDER_PRIOR}",)


def beyond_modulus(
    p: np.ndarray, stderr: np.ndarray, modulus_Pa: float | None, resolved_dof: float = 1.0
) -> Sequence[str]:
    """Warning on pressures (cell,) [Pa] that exceed the skin's Young's modulus by more than chance
    makes among as many independent ones as are resolved; None: it is not known, or p is relative.

    Under such a pressure no skin is linear: strains are of order one.
    """
    chance = -scipy.special.ndtri(false_alarm.CHECK / max(resolved_dof, 1.0))
    peak = float(np.max(np.abs(p), initial=0.0, where=np.isfinite(p)))
    surely = np.abs(p) - chance * stderr
    if (
        modulus_Pa is None
        or not np.max(surely, initial=0.0, where=np.isfinite(surely)) > modulus_Pa
    ):
        return ()
    return (
        f"p reaches {1e-3 * peak:.3g} kPa, {peak / modulus_Pa:.2g} times the skin's Young's "
        "modulus. No skin stays elastic under this pressure, so a scale is wrong. Check "
        "recording.gain, recording.signal_unit, the film's constants and skin.youngs_modulus_Pa.",
    )


def noise_alone() -> Sequence[str]:
    """Warning on bands of a prior with edges."""
    return (
        "Bands with prior=edges hold the errors by noise alone: they take plateaus and edges as "
        "certain. Compare the estimate with that of prior=gaussian.",
    )


def no_level() -> Sequence[str]:
    """Warning on a constraint on the pressure that says nothing, as its mean is not known."""
    return (
        "The mean pressure is not known, so p >= 0 holds at some level and says nothing. The "
        "estimate is that of prior=gaussian. Give nominal_pressure_Pa in the sidecar.",
    )


def negative_load(name: str, value: float, stderr: float) -> Sequence[str]:
    """Warning on a feature whose pressure, with that of its surroundings, is below zero."""
    if not -value > -scipy.special.ndtri(false_alarm.CHECK) * stderr:
        return ()
    words = _pull_in_words(f"{name.replace('_', ' ')} is {value:.3g}", -value / stderr)
    return (f"{words} {CHECK_SIGNS}",)


def without_wiring(warnings: str) -> str:
    """Warnings on an estimate from simulated signals, without the advice to check a recording's
    signs and channels: the sensor that made the signals is known."""
    prior = OR_A_WIDER_PRIOR, "The prior is too narrow, and so is the band."
    return warnings.replace(f" {CHECK_SIGNS}", "").replace(*prior)


def _pull_in_words(what: str, below: float) -> str:
    return f"{what}, {below:.2g} standard errors below zero, but a contact cannot pull."


def residual_over_noise(
    chi2_per_dof: float | None,
    degrees_of_freedom: float | int,
    most_rms: float = OVER_NOISE,
    level_stderr: float = 0.0,
) -> Sequence[str]:
    """Warning on a whitened residual with this chi-square, None where the noise is not known, whose
    level has a relative standard error of `level_stderr`."""
    if chi2_per_dof is None or not is_excess(
        chi2_per_dof, degrees_of_freedom, most_rms, level_stderr
    ):
        return ()
    return (
        f"The residual is {np.sqrt(chi2_per_dof):.2g} times the noise, so the bands are too "
        "narrow. The model omits an effect on the signal, or the noise is larger than stated.",
    )


def unchecked_residual(chi2_per_dof: float | None) -> Sequence[str]:
    """Warning on a chi-square that is undefined although the noise is known."""
    if chi2_per_dof is not None:
        return ()
    return (
        "Chi-square is undefined: the fit uses every degree of freedom of the signal. No residual "
        "is left to check the bands.",
    )


def beyond_band(name: str, z: float, resolved_dof: float) -> Sequence[str]:
    """Warning on a component whose rms error is `z` standard errors, by the known truth; NaN where
    there is no band. Under the model the square of z scatters as a chi-square of the
    `resolved_dof`, over these."""
    freedom = max(resolved_dof, 1.0)
    if not z > max(MOST_Z, np.sqrt(scipy.special.chdtri(freedom, false_alarm.CHECK) / freedom)):
        return ()
    return (
        f"The error of {name} is {z:.2g} times its standard error (rms, by the known truth), so "
        "its band is too narrow.",
    )


def error_over_truth(error: float) -> Sequence[str]:
    """Warning on a relative `error` of p and q together, by the known truth, that is larger than
    these; NaN of a truth that is uniform."""
    if not error > 1:
        return ()
    return (
        f"The error of p and q is {error:.3g} times their own size (by the known truth). A uniform "
        "traction has a smaller error.",
    )


def unresolved_waves(name: str, resolution: float) -> Sequence[str]:
    """Warning on a component whose shortest wave has this `resolution`."""
    if not resolution > RESOLVED_GAIN:
        return ()
    return (
        f"The signal resolves {name} down to waves of two cells. Shorter waves are in the signal, "
        "too, and are mistaken for longer ones. Use narrower cells.",
    )


def changing_in_runs(
    name: str,
    resolved_dof: float,
    observed: float,
    of_prior: float,
    *,
    run_m: float,
    lengths: float,
) -> Sequence[str]:
    """Warning on a component that changes more over the length of a run of missing samples than its
    prior allows.

    `observed`: the mean square of its change where it is seen, over so many independent `lengths`;
    `of_prior`: the prior's [Pa^2]; `resolved_dof`: of its degrees of freedom, what would have been
    resolved in one run. With less than one, a run is bridged by what is beside it.
    """
    chance = scipy.special.chdtri(max(lengths, 1.0), false_alarm.CHECK) / max(lengths, 1.0)
    ratio = observed / of_prior if of_prior > 0 else 0.0
    if resolved_dof < LEAST_RESOLVED_DOF or not ratio > max(MOST_CHANGE, chance):
        return ()
    return (
        f"Samples are missing in runs of {1e3 * run_m:.2g} mm. There the prior allows {name} to "
        f"change by {1e-3 * np.sqrt(of_prior):.2g} kPa, but elsewhere it changes by "
        f"{1e-3 * np.sqrt(observed):.2g} kPa, so its band is too narrow in the runs. Use "
        "rule=evidence, or a wider prior: a smaller weight or a larger rms.",
    )


def rough_bands(defect: float) -> Sequence[str]:
    """Warning on bands of the iterative path, of a map with this `defect` on noise: rounding makes
    it, under a prior far weaker than the data."""
    if not defect > MOST_DEFECT:
        return ()
    return (
        f"Bands are rough: a test with noise finds an error of {100 * defect:.0f} % in their "
        "approximate covariance. Use larger weights, a stronger prior or path=direct.",
    )


def correlated_elements(why: str) -> Sequence[str]:
    """Warning on noise that elements share and that is taken as independent."""
    return (
        f"The elements share noise that is taken as independent, because {why}: bands may be too "
        "narrow. Leave out what makes it so, or compare with effects without snap_back.",
    )


def missing(fraction: float) -> Sequence[str]:
    """Warning on a `fraction` of samples missing within the scan."""
    if fraction <= FEW_MISSING:
        return ()
    return (
        f"{100 * fraction:.3g} % of the samples are missing. If they were out of range (rails), "
        "the answer lacks the strongest part of the signal.",
    )


def raised_weights(decades: float) -> Sequence[str]:
    """Warning on weights that are so many decades above those chosen."""
    if not decades:
        return ()
    return (
        f"The weights were raised to 10^{decades:.0f} times those of the rule, with which rounding "
        "would dominate. The signal does not fit the model. Check the angles, depths, offsets and "
        "gains of the elements, and hum.",
    )


def unchecked(what: str = "inversion") -> Sequence[str]:
    """Warning on an estimate that was computed under jit, vmap or grad."""
    return (
        f"JAX traced this {what}: its validity was not checked. To see its warnings, call "
        "it once outside jit, vmap and grad.",
    )


def undetermined_weights(status: Status) -> Sequence[str]:
    """Warning on weights that a rule failed to choose."""
    if status.is_answer:
        return ()
    return (f"The band takes the weights as known, but one is {status}. The signal does not "
            "determine it. Set the weight.",)  # fmt: skip


def too_long_correlation() -> Sequence[str]:
    """Warning on a correlation length that is longer than the data's."""
    return (
        "The data favour a shorter correlation length than the stated one, so the bands are too "
        "narrow where the traction changes over less. Set method.wiener.correlation=evidence, or "
        "state a shorter correlation_m.",
    )


def not_for_bands(rule: str) -> Sequence[str]:
    """Warning on the bands of weights that this rule has chosen, whose 90 % bands held 36 to 80 %
    of truths from the prior (`experiment=calibration_of_bands`)."""
    return (
        f"The rule ({rule}) does not choose weights for their bands, which are often too narrow. "
        "For bands, choose the weights by rule=evidence.",
    )


def below_rounding(noise_rms: float, largest: float, dtype: np.dtype) -> Sequence[str]:
    """Warning on noise below the rounding of the data."""
    if noise_rms >= np.finfo(dtype).eps * largest:
        return ()
    return (
        f"The noise ({noise_rms:.2g}) is smaller than the rounding of {dtype.name} on data of "
        f"{largest:.2g}. The bands do not include the rounding.",
    )


# --- of fits -----------------------------------------------------------------------------------


def of_fit(
    chi2_per_dof: float | None,
    degrees_of_freedom: float | int,
    at_bound: Sequence[str],
    undetermined: Sequence[Mapping[str, float]],
    level_stderr: float = 0.0,
) -> tuple[str, ...]:
    """Warnings on a nonlinear fit: its residual, and parameters without valid standard errors.

    Any residual beyond chance counts, however many data there are: a misfit of 14 % in chi-square
    over 40,000 of them can move a parameter by 70 standard errors.
    """
    return (
        *residual_over_noise(chi2_per_dof, degrees_of_freedom, 0.0, level_stderr),
        *(
            f"The data do not determine the direction ({direction_in_words(each)}): a move of the "
            "parameters along it does not change the signal."
            for each in undetermined
        ),
        *_on_bounds(at_bound),
    )


def false_minimum(chi2_per_dof: float | None, degrees_of_freedom: float | int) -> tuple[str, ...]:
    """Warning on one fit of many whose chi-square noise alone exceeds less than once in a thousand
    times, None where the noise is not known."""
    if chi2_per_dof is None or not degrees_of_freedom >= 1:
        return ()
    chi2 = chi2_per_dof * degrees_of_freedom
    if scipy.special.chdtrc(degrees_of_freedom, chi2) >= false_alarm.CHECK:
        return ()
    return (
        f"The residual is {np.sqrt(chi2_per_dof):.3g} times the noise, which chance makes less "
        "than once in a thousand times. This may be a false minimum: give a nearer start. Else the "
        "model or the noise is not as stated.",
    )


def slope_by_differences(times_noise: float) -> tuple[str, ...]:
    """Warning on a minimum in which differences of the model over steps still have a slope, so many
    times the rms of that which noise makes, and more than chance does along one direction."""
    if not times_noise**2 > scipy.special.chdtri(1, false_alarm.CHECK):
        return ()
    return (
        "At the minimum of the fit, finite differences of the cost still have a slope of "
        f"{times_noise:.2g} times that of noise. The model does not fit there, and its standard "
        "errors are too small. Check the model and the stated facts.",
    )


def direction_in_words(direction: Mapping[str, float]) -> str:
    """A direction in the space of the parameters, as moves by name."""
    return ", ".join(f"{name} {move:+.3g}" for name, move in direction.items())


def _on_bounds(names: Sequence[str]) -> Sequence[str]:
    if not names:
        return ()
    return (
        f"On a bound of its range: {', '.join(names)}. The best value lies outside, so its "
        "standard error and those of parameters tied to it are invalid. Widen the range, or check "
        "the model.",
    )


def undetected(name: str) -> str:
    """Warning on a feature that is not detected."""
    return (
        f"The data do not detect {name.replace('_', ' ')}: a search in noise alone finds as much. "
        "Its position, width and friction have infinite standard errors, and its strength has that "
        "of the prior."
    )


def local_misfit(excess: float) -> Sequence[str]:
    """Warning on a residual whose power where the fitted signal is, is `excess` times that of the
    noise; 1 where chance makes as much."""
    if not excess > 1:
        return ()
    return (
        f"Residuals at the feature are {np.sqrt(excess):.2g} times the noise (means over half a "
        f"depth). The model does not fit there, and standard errors are too small. {WRONG_KIND}",
    )


def widened_for_misfit(overall: float, local: float, remedy: str = "") -> Sequence[str]:
    """Warning on standard errors that are widened, as the residual's power is more than the
    noise's: `overall` times, and `local` times where the fitted signal is; 1 where chance makes as
    much. `remedy`: a sentence on what to try first."""
    if not max(overall, local) > 1:
        return ()
    over = f"The residual is {np.sqrt(overall):.2g} times the noise"
    near = f"Residuals at the feature are {np.sqrt(local):.2g} times the noise"
    said = near if local > ALL_OVER * overall else over
    return (
        f"{said}: the model does not fit. The noise's part of the standard errors is increased by "
        f"this factor. {WRONG_KIND}{remedy}",
    )


def sliding_noise(fraction: float) -> Sequence[str]:
    """Warning on noise estimated from a fit's residual, its correlated part `fraction` of the
    signal."""
    if not fraction > MUCH_SLIDING:
        return ()
    return (
        f"The residual has a correlated part of {100 * fraction:.0f} % of the signal, more than "
        "the noise of sliding. The feature may be of another kind, or have others beside it. A "
        "groove is a ridge with negative heights in its height_range_m.",
    )
