"""Stick-slip: patches of skin that stick while the finger slides, and snap back.

Each event is a jump of the shear on one patch, which stays where it is on the finger while it
relaxes. A film's response to it is the charge Q of a uniform shear on a strip of the patch's
length: the recording is a shot noise (Campbell's theorem; Rice 1944, part I).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Complex, Float, PRNGKeyArray

from ..errors import number, refuse
from ..grid import Line, as_real
from ..known import namespace
from .amplifier import Amplifier
from .filter import Filter
from .noise import NonGaussianNoise, exponential_spectrum
from .scan import ConstantSpeed
from .sensor import FilmSignal, Sensor

PANELS, NODES = 32, 16  # of Gauss's rule over the contact: to round-off up to 50 depths
MOST_TERMS = 512  # of the films' response over the contact, in Chebyshev polynomials: likewise
TRUNCATION_ERROR = 1e-10  # of the response, by what terms there are where the contact is shorter
BLOCK = 128  # events drawn at once
MOST_PER_S = 1e6
MOST_DEPTHS = 200  # of contact: beyond, panels and terms do not resolve the shallowest response

# Of events at places along the contact, and of an age.
Contribution = Callable[[Float[Array, " event"], Float[Array, " event"]], Float[Array, "r event"]]


class SnapBackNoise(NonGaussianNoise):
    """Events at random times, `rate_hz` a second, at places uniform over the contact.

    - `shear_Pa`: rms of a jump's amplitude, Gaussian with mean zero; it decays as exp(-t/decay_s).
    - `patch_m`: a patch's length; `contact_m`: that of the contact, about the sensor's origin.
    - `charge`, `amplifier`, `filters`: the response to a load, its readout, and the filters behind.

    All elements respond to the same events: `cross_spectrum` has the matrix of their noise, and the
    spectrum is the mean over them. A sample of a
    rate signal is the mean over the sampling interval before it, v_j = R_f (Q_j - Q_{j-1})/dt, one
    of an amplifier of order 0 its gain times Q_j. The filters act on these samples. Nothing happens
    at rest, nor without a contact. The film's effects act as on a load, so that an average of
    neighbouring samples, which is one over time, has no meaning here.

    Raises `BadInput` for a rate, shear or contact below 0, more than 10^6 events a second, a patch
    or decay that is not positive, and a contact of more than 200 depths of the shallowest film.
    """

    charge: FilmSignal
    amplifier: Amplifier
    filters: tuple[Filter, ...]
    rate_hz: Float[Array, ""]
    shear_Pa: Float[Array, ""]
    patch_m: Float[Array, ""]
    decay_s: Float[Array, ""]
    contact_m: Float[Array, ""]
    terms: int = eqx.field(static=True)

    def __init__(
        self,
        charge: FilmSignal,
        amplifier: Amplifier,
        filters: tuple[Filter, ...],
        rate_hz,
        shear_Pa,
        patch_m,
        decay_s,
        contact_m,
    ):
        self.charge, self.amplifier, self.filters = charge, amplifier, filters
        wanted = f"a number of events per second, from 0 to {MOST_PER_S:g}"
        self.rate_hz = as_real(number("noise rate_hz", rate_hz, wanted, least=0, most=MOST_PER_S))
        wanted = "a shear in Pa that is at least 0"
        self.shear_Pa = as_real(number("noise shear_Pa", shear_Pa, wanted, least=0))
        wanted = "a positive length in metres"
        self.patch_m = as_real(number("noise patch_m", patch_m, wanted, above=0))
        wanted = "a positive time in seconds"
        self.decay_s = as_real(number("noise decay_s", decay_s, wanted, above=0))
        wanted = "a length in metres that is at least 0"
        self.contact_m = as_real(number("noise contact_m", contact_m, wanted, least=0))
        depths_m = [film.depth_m for film in charge.elements]
        if any(isinstance(value, Tracer) for value in (contact_m, *depths_m)):
            self.terms = MOST_TERMS
        else:
            contact, depth = float(contact_m), min(float(depth) for depth in depths_m)
            most = MOST_DEPTHS * depth
            refuse(
                contact > most,
                f"noise contact_m is {contact:.6g}: give at most {most:.6g} m, {MOST_DEPTHS} "
                "times the depth of the shallowest film.",
            )
            self.terms = _terms(contact, depth)

    @classmethod
    def recorded_by(
        cls, sensor: Sensor, rate_hz, shear_Pa, patch_m, decay_s, contact_m
    ) -> "SnapBackNoise":
        """The noise as this sensor records it. Envelopes do not act on it: a burst is a load of its
        own, not the surface's."""
        readout = sensor.touching_everywhere().charge(), sensor.amplifier, sensor.filters
        return cls(*readout, rate_hz, shear_Pa, patch_m, decay_s, contact_m)

    def spectrum(
        self, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""]
    ) -> Float[Array, " k"]:
        interval, per_s = self.interval_and_rate(line, scan)
        relaxation_m = self.decay_s / interval * line.cell_m
        held = exponential_spectrum(line.k, line.cell_m, relaxation_m)
        power = per_s * self._mean_square(line, scan) * self.decay_s / 2 * held
        power = power * jnp.abs(self._passed(line, interval)) ** 2
        # The squared modulus of the difference between neighbours.
        return power * (2 * jnp.sin(line.k * line.cell_m / 2)) ** 2 if self.is_rate else power

    def cross_spectrum(
        self, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""], elements: int
    ) -> Float[Array, "e e k"]:
        """Cross-spectral matrix: the spectrum, shared out as mean products of two films' charges
        by the same jump."""
        jump, weight = self._jumps(line, scan)
        products = (jump * weight[None]) @ jump.T
        mean = jnp.mean(jnp.diag(products))
        shares = products / jnp.where(mean > 0, mean, 1.0)
        return shares[..., None] * self.spectrum(line, scan, signal_rms)[None, None]

    def draw(
        self, key: PRNGKeyArray, line: Line, scan: ConstantSpeed, signal_rms: Float[Array, ""]
    ) -> Float[Array, "e n"]:
        """Events drawn one by one, their decay carried over from the last sample to the first.

        Not differentiable in reverse: the number of events is random.
        """
        interval, per_s = self.interval_and_rate(line, scan)
        ratio = interval / self.decay_s
        fresh = self._fresh(key, line.n, per_s * line.n * interval, ratio)
        recorded = relaxing(line.k * line.cell_m, ratio, self.is_rate) * self._passed(
            line, interval
        )
        signal = jnp.fft.irfft(recorded[None] * jnp.fft.rfft(fresh), line.n)
        signal = self._reading(line, scan) * self.shear_Pa * signal
        # The first sample in time is the last one along x where the finger slides backwards.
        return jnp.where(scan.direction < 0, signal[:, ::-1], signal)

    def recorded(self, line: Line, scan: ConstantSpeed) -> Complex[Array, " k"]:
        """Transfer from [`relaxing`][] charge to the signal, over the samples in time: the
        amplifier's factor and the filters."""
        interval, _ = self.interval_and_rate(line, scan)
        return self._reading(line, scan) * self._passed(line, interval)

    @property
    def is_rate(self) -> bool:
        """Whether a sample is the charge's difference to the one before."""
        return self.amplifier.order > 0

    def interval_and_rate(
        self, line: Line, scan: ConstantSpeed
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Sampling interval [s], arbitrary at rest, and rate of events [1/s], 0 at rest."""
        samples_per_s = scan.sample_rate_hz(line)
        moves = samples_per_s > 0
        interval = 1 / jnp.where(moves, samples_per_s, 1.0)
        return interval, jnp.where(moves & (self.contact_m > 0), self.rate_hz, 0.0)

    def _reading(self, line: Line, scan: ConstantSpeed) -> Float[Array, ""]:
        """The factor on the charge, or on its difference between samples: R_f/dt."""
        if not self.is_rate:
            return self.amplifier.at_speed(scan.speed_m_per_s)
        return self.amplifier.at_speed(jnp.abs(scan.speed_m_per_s)) / line.cell_m

    def _passed(self, line: Line, interval: Float[Array, ""]) -> Complex[Array, " k"]:
        """Transfer of the filters for samples one `interval` apart."""
        passed = jnp.ones(line.k.shape, complex)
        for each in self.filters:
            passed = passed * each.response(line.k * line.cell_m / interval)
        return passed

    def response(self, place_m: Float[Array, " event"]) -> Float[Array, "e event"]:
        """Every film's charge [C/Pa] per unit shear on patches at these places."""
        return self.charge.cell_response(-place_m, self.patch_m)[:, 1]

    def _over_contact(self) -> Float[Array, "e term"]:
        """The response over the contact by Chebyshev polynomials: one event's is then a sum of
        cosines, whatever the skin."""
        angle = np.pi * (np.arange(self.terms) + 0.5) / self.terms
        response = self.response(self.contact_m / 2 * as_real(np.cos(angle)))
        return (jax.scipy.fft.dct(response) / self.terms).at[:, 0].multiply(0.5)

    def _mean_square(self, line: Line, scan: ConstantSpeed) -> Float[Array, ""]:
        """Mean square of a jump in the signal: over amplitudes, the contact and the elements."""
        jump, weight = self._jumps(line, scan)
        return jnp.mean(jump**2 @ weight)

    def _jumps(
        self, line: Line, scan: ConstantSpeed
    ) -> tuple[Float[Array, "e place"], Float[Array, " place"]]:
        """The jump in every signal of an event of rms shear at places of the contact, and the
        weights of the places in a mean over it."""
        node, weight = np.polynomial.legendre.leggauss(NODES)
        middle = 2 * np.arange(PANELS) + 1 - PANELS
        places = ((middle[:, None] + node[None]) / PANELS).ravel()
        response = self.response(self.contact_m / 2 * as_real(places))
        # Squared as a signal: a charge's square is beyond single precision.
        jump = self._reading(line, scan) * self.shear_Pa * response
        return jump, as_real(np.tile(weight, PANELS) / (2 * PANELS))

    def _fresh(
        self, key: PRNGKeyArray, n: int, expected: Float[Array, ""], ratio: Float[Array, ""]
    ) -> Float[Array, "e n"]:
        """Per unit shear, the charge at every sample of the events since the one before, with
        `ratio` the sampling interval over the decay."""
        over_contact, term = self._over_contact(), jnp.arange(self.terms)

        def contribution(along, age):
            response = over_contact @ jnp.cos(term[:, None] * jnp.arccos(along)[None])
            return jnp.exp(-ratio * age)[None] * response

        return sum_over_events(key, expected, n, len(self.charge.elements), contribution)


def relaxing(angle: Any, ratio: Any, is_rate: bool) -> Any:
    """Transfer from fresh charge to charge that relaxes, over the samples in time.

    - `angle` [rad]: between neighbouring samples; `ratio`: the sampling interval over the decay;
      `is_rate`: whether a sample is the charge's difference to the one before.
    """
    xp = namespace(angle, ratio)
    half = angle / 2
    difference = 2j * xp.sin(half) * xp.exp(-1j * half)
    # 1 - exp(-ratio - i angle), without cancelling where the decay is slow.
    denominator = -xp.expm1(-ratio) + xp.exp(-ratio) * difference
    return (difference if is_rate else 1.0) / denominator


def sum_over_events(
    key: PRNGKeyArray,
    expected: Float[Array, ""],
    n: int,
    rows: int,
    contribution: Contribution,
) -> Float[Array, "r n"]:
    """Random events, so many `expected` over n samples, each added at the first sample after it:
    its Gaussian amplitude times its `contribution(along, age)`.

    `along`: its place in the contact, from -1 to 1. `age`: the time since it, in intervals. The
    same key gives the same events to every sensor.
    """
    for_number, for_events = jax.random.split(key)
    number_of_events = jax.random.poisson(for_number, expected)

    def add(block, total):
        for_places, for_sizes = jax.random.split(jax.random.fold_in(for_events, block))
        # One draw for three, as every draw is long to compile.
        along, age, when = jax.random.uniform(for_places, (3, BLOCK))
        amplitude = jax.random.normal(for_sizes, (BLOCK,))
        sample = jnp.minimum(jnp.floor(when * n).astype(int), n - 1)
        happens = block * BLOCK + jnp.arange(BLOCK) < number_of_events
        each = jnp.where(happens, amplitude, 0.0)[None] * contribution(2 * along - 1, age)
        return total.at[:, sample].add(each)

    blocks = (number_of_events + BLOCK - 1) // BLOCK
    return jax.lax.fori_loop(0, blocks, add, jnp.zeros((rows, n)))


def _terms(contact_m: float, depth_m: float) -> int:
    """Number of Chebyshev polynomials that resolve a response analytic within a depth of the real
    axis: they converge as (s + sqrt(1 + s^2))^-terms, s the depth over half the contact. A power of
    2, so that similar contacts share one program."""
    half = contact_m / 2
    wanted = -np.log(TRUNCATION_ERROR) / np.arcsinh(depth_m / half) if half > 0 else 1.0
    return int(min(MOST_TERMS, 2 ** np.ceil(np.log2(max(wanted, 16.0)))))
