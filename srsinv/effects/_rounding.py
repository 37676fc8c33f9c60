"""What rounding to a converter's levels makes of a change: a bound on its rms."""

import math
from functools import cached_property

import numpy as np
from jaxtyping import Float

from ._reference import ReferenceSpectra

# Fraction of the signal that effects that stay on may change before it is simulated with them.
LARGEST_UNSIMULATED_CHANGE = 0.1
LEAST_EXPECTED_FLIPS = 1e-3  # of samples over all of them: fewer do not happen


class RoundedSignal:
    """The reference's signal, rounded to multiples of `step`, over its rms; 0: not rounded.

    A change of d turns a sample over where a tie is within d, by a step beyond the change itself:
    in all, d^2 + step^2 times the fraction of samples that turn. The signal is known but for an
    offset, so that this is the fraction within d at the worst one; samples that are always rounded
    to zero do not turn.
    """

    def __init__(self, spectra: ReferenceSpectra, step: float):
        self.step = step
        self._spectra = spectra

    def bound(self, change: float) -> float:
        """A bound on the rms of a `change` once samples are rounded, both over the signal's rms."""
        return math.sqrt(change**2 + self.step**2 * self._turned_part(change))

    def _turned_part(self, change: float) -> float:
        spectra, step = self._spectra, self.step
        count = len(spectra.transfer_of_others) * spectra.line.n
        if not 0 < step < math.inf or change / step * count < LEAST_EXPECTED_FLIPS:
            return 0.0
        if change >= step:
            return change / step
        phases, size = self._sorted
        phases = phases[size * (1 + LARGEST_UNSIMULATED_CHANGE) + change >= step / 2]
        twice = np.concatenate([phases, phases + 1])
        most = np.searchsorted(twice, phases + change / step, side="right")
        most -= np.arange(phases.size)
        return max(float(most.max(initial=0)) / count, change / step)

    @cached_property
    def _sorted(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Every sample's phase within a step, in increasing order, and its size: sorted once for
        all changes."""
        spectra = self._spectra
        samples = np.fft.irfft(spectra.transfer_of_others * spectra.signal, spectra.line.n).ravel()
        samples = samples / spectra.signal_rms
        phases = samples / self.step % 1.0
        order = np.argsort(phases)
        return phases[order], np.abs(samples)[order]
