"""What semi-blind inversion finds of a rig over unknown surfaces (a quarter of an hour).

A sensor of 0.75 mm depth scans surfaces of many kinds at 40 dB. Its depth is stated wrong by up to
30 %, the gain of element 2 by 15 % (rms) and its angle by 5 degrees (rms). Traction is simulated on
cells a fourth as wide as those of the inversion. The bound is the Cramer-Rao bound by the spectra
that the surfaces are drawn from, where they have one.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.rig.found import FoundFacts
from srsinv.inverse.semi_blind import SemiBlind
from srsinv.inverse.wiener import TractionSpectrum
from srsinv.jobs.trials import Row
from tests.claims.study import Study
from tests.inverse.rough_scans import DEPTH_M, P_PA, Q_PA, SPECTRA, SURFACE, rough_scan, sensor

MANY, SOME, FEW = 100, 20, 8
FARTHEST, GAIN, ANGLE_DEG = 0.3, 0.15, 5.0  # how far facts are from what is stated


@dataclasses.dataclass(frozen=True)
class Setting:
    """Scans of a surface: `elements`, p and q `independent` or q = mu p, their length and noise,
    and the facts that are unknown."""

    surface: str
    draws: int
    elements: int = 2
    independent: bool = False
    length_m: float = 0.04
    snr_dB: float = 40.0
    unknown: tuple[str, ...] = ("depth_m", "gain", "angle_deg")


SETTINGS = {
    "exponential": Setting("exponential", MANY),
    "Hurst 0.8": Setting("Hurst 0.8", MANY),
    "ridges": Setting("ridges", SOME),
    **{
        name: Setting(name, SOME)
        for name in (
            "Hurst 0.5",
            "Hurst 1",
            "Gaussian",
            "white",
            "waves",
            "tape",
            "partial contact",
        )
    },
    "depth alone": Setting("Hurst 0.8", SOME, unknown=("depth_m",)),
    "20 dB": Setting("Hurst 0.8", SOME, snr_dB=20.0),
    "10 mm": Setting("Hurst 0.8", SOME, length_m=0.01),
    "one element, exponential": Setting("exponential", SOME, elements=1),
    "one element, Hurst 0.8": Setting("Hurst 0.8", SOME, elements=1),
    "one element, waves": Setting("waves", SOME, elements=1),
    "p and q independent, exponential": Setting("exponential", FEW, independent=True),
    "p and q independent, Hurst 0.8": Setting("Hurst 0.8", FEW, independent=True),
}


class Drawn(TractionSpectrum):
    """The spectrum that a surface is drawn from, at an rms."""

    shape: Callable
    rms_Pa: float

    def power(self, problem: LineProblem):
        k = np.asarray(SURFACE.k)
        whole = self.shape(k)
        whole[0] = 0.0
        mean = (2 * whole.sum() - whole[-1]) / SURFACE.n
        waves = np.maximum(np.asarray(problem.line.k), k[1])
        density = self.rms_Pa**2 * float(SURFACE.cell_m) / mean
        return np.maximum(self.shape(waves), 1e-12) * density / float(problem.line.cell_m)


def drawn(setting: str) -> Row:
    """Errors and standard errors of the depth over draws, in per cent of it; the share of draws
    within three standard errors, within 2 %, and said to be identifiable; the bound."""
    of, rng = SETTINGS[setting], np.random.default_rng(11)
    errors, stderrs, identifiable, bounds = [], [], [], []
    for seed in range(of.draws):
        stated = sensor(DEPTH_M * (1 + FARTHEST * rng.uniform(-1, 1)), of.elements)
        gain, angle_deg = 1.0, 90.0
        if len(of.unknown) > 1:
            gain, angle_deg = np.exp(GAIN * rng.normal()), 90.0 + ANGLE_DEG * rng.normal()
        true = sensor(DEPTH_M, of.elements, gain, angle_deg)
        own = {"length_m": of.length_m, "snr_dB": of.snr_dB, "independent": of.independent}
        problem = rough_scan(of.surface, seed, stated, true, **own).problem
        method = SemiBlind(of.unknown)
        found = FoundFacts.of(problem, method.names(problem))
        value, stderr = found.parameters["depth_m"]
        errors.append(value / DEPTH_M - 1)
        stderrs.append(stderr / value)
        identifiable.append("depth_m" not in found.lost)
        if seed < 3 and of.surface in SPECTRA:
            spectra = (Drawn(SPECTRA[of.surface], rms) for rms in (P_PA, Q_PA))
            exact = problem.with_rig(true, None)
            bounds.append(method.expected_stderr(exact, *spectra)["depth_m"] / DEPTH_M)
    wrong, stderr = np.abs(errors), np.array(stderrs)
    return {
        "bound_percent": 100 * float(np.mean(bounds)) if bounds else None,
        "rms_error_percent": 100 * float(np.sqrt(np.mean(wrong**2))),
        "stderr_percent": 100 * float(np.median(stderr)),
        "within_3_stderr": float(np.mean(wrong < 3 * stderr)),
        "within_2_percent": float(np.mean(wrong < 0.02)),
        "identifiable": float(np.mean(identifiable)),
    }


STUDY = Study(
    "semi_blind",
    drawn,
    lambda: [{"setting": name} for name in SETTINGS],
    rests_on=lambda setting: dataclasses.asdict(SETTINGS[setting]),
)
