"""The skin acceleration sensor: a small accelerometer on the inner face of the skin.

It is a mass on the foam's stiffness and damping, driven by the force F of the contact on the patch
of skin above it (Howe and Cutkosky 1989): m x'' + c x' + k x = F, and the signal is a = x''. The
force is the traction of the patch, weighted with the contact's envelope along x, times the patch's
length across. The skin itself moves as one with the mass: its own waves are left out.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, PRNGKeyArray

from ..compiled import compiled
from ..errors import choice, number, refuse
from ..grid import Convolution, Line, Operator, Stage, as_real
from ..known import is_traced
from .filter import causal, even_interval
from .operator import MotionOperator, PositionInterpolation
from .scan import ConstantSpeed, Motion
from .snap_back import SnapBackNoise, sum_over_events
from .window_transform import first_bessel_over

STANDARD_GRAVITY_M_PER_S2 = 9.80665
AXES = ("normal", "tangential")  # driven by p, and by q
E_FOLDS = 31.0  # until a response has decayed to 3e-14
TRACED_NODES, MOST_NODES = 512, 4096  # of the integral over the contact, on an open line
AGES, WEIGHTS = np.polynomial.legendre.leggauss(24)  # of an event within a sampling interval
SERIES_TERMS = 10  # of sinh(z)/z for |z| < 1: the next is 2e-20


def envelope_transform(k: Float[Array, " k"], contact_m: Float[Array, ""]) -> Float[Array, " k"]:
    """Fourier transform [m] of Hertz's envelope sqrt(1 - (x/a)^2), a half of `contact_m`:
    pi a J1(ka)/(ka)."""
    half = contact_m / 2
    return np.pi * half * first_bessel_over(k * half)


def envelope_integral(x: Float[Array, " x"], contact_m: Float[Array, ""]) -> Float[Array, " x"]:
    """Integral [m] of the same envelope from its middle to x."""
    half = contact_m / 2
    inside = jnp.abs(x) < half
    s = jnp.where(inside, x, 0.0) / half
    within = (s * jnp.sqrt(1 - s**2) + jnp.arcsin(s)) / 2
    return half * jnp.where(inside, within, np.pi / 4 * jnp.sign(x))


class SkinAccelerometer(eqx.Module):
    """An accelerometer on the inner face of the skin, above foam.

    - `mass_kg`, `stiffness_N_per_m`, `damping_ratio`: of the oscillator; 1 g on 1 kN/m resonates at
      159 Hz.
    - `axis`: "normal", driven by p, with acceleration into the finger; or "tangential", driven by
      q, with acceleration along +x.
    - `contact_m`: length of the contact along x, over which its envelope is Hertz's.
    - `length_m`: length of the patch across.
    - `noise_density_m_per_s2_per_rtHz`: of its white noise, 0.5 mg per root hertz by default.

    Defaults are typical of the sensors of Howe and Cutkosky (1989, 1993). Raises `BadInput` for a
    mass, stiffness, damping or length that is not positive, a negative noise and another axis.
    """

    mass_kg: Float[Array, ""]
    stiffness_N_per_m: Float[Array, ""]
    damping_ratio: Float[Array, ""]
    contact_m: Float[Array, ""]
    length_m: Float[Array, ""]
    noise_density_m_per_s2_per_rtHz: Float[Array, ""]
    axis: str = eqx.field(static=True)

    def __init__(
        self,
        mass_kg=1e-3,
        stiffness_N_per_m=1e3,
        damping_ratio=0.2,
        axis: str = "normal",
        contact_m=8e-3,
        length_m=8e-3,
        noise_density_m_per_s2_per_rtHz=0.5e-3 * STANDARD_GRAVITY_M_PER_S2,
    ):
        def positive(name, value, unit):
            wanted = f"a positive {unit}"
            return as_real(number(f"accelerometer.{name}", value, wanted, above=0))

        self.mass_kg = positive("mass_kg", mass_kg, "mass in kg")
        unit = "stiffness in N/m"
        self.stiffness_N_per_m = positive("stiffness_N_per_m", stiffness_N_per_m, unit)
        self.damping_ratio = positive("damping_ratio", damping_ratio, "number")
        self.contact_m = positive("contact_m", contact_m, "length in metres")
        self.length_m = positive("length_m", length_m, "length in metres")
        name = "noise_density_m_per_s2_per_rtHz"
        wanted, density = "a number that is at least 0", noise_density_m_per_s2_per_rtHz
        density = number(f"accelerometer.{name}", density, wanted, least=0)
        self.noise_density_m_per_s2_per_rtHz = as_real(density)
        self.axis = choice("accelerometer.axis", axis, AXES)

    @property
    def resonance_rad_per_s(self) -> Float[Array, ""]:
        """Angular frequency of the undamped mass, sqrt(k/m)."""
        return jnp.sqrt(self.stiffness_N_per_m / self.mass_kg)

    def response(self, omega_rad_per_s: Float[Array, " k"]) -> Complex[Array, " k"]:
        """Acceleration per force [1/kg]: -w^2/(k - m w^2 + i w c), c = 2 zeta sqrt(k m)."""
        ratio = omega_rad_per_s / self.resonance_rad_per_s
        return -(ratio**2) / (1 - ratio**2 + 2j * self.damping_ratio * ratio) / self.mass_kg

    def ramp_response(self, time_s: Float[Array, "..."]) -> Float[Array, "..."]:
        """Acceleration [m/s^2] at times from 0 on, of a force that grows by 1 N/s from time 0:
        t exp(-zeta w t) sinh(b t)/(b t)/m, b^2 = w^2 (zeta^2 - 1)."""
        phase = self.resonance_rad_per_s * time_s
        square = (self.damping_ratio**2 - 1) * phase**2
        return time_s / self.mass_kg * _decaying_sinhc(square, self.damping_ratio * phase)

    def step_response(self, time_s: Float[Array, "..."]) -> Float[Array, "..."]:
        """Acceleration [m/s^2] at times from 0 on, of a force of 1 N from time 0 on."""
        return jax.jvp(self.ramp_response, (time_s,), (jnp.ones_like(time_s),))[1]

    @compiled
    def in_time(
        self, force_N: Float[Array, "e sample"], interval_s: Float[Array, ""]
    ) -> Float[Array, "e sample"]:
        """Acceleration [m/s^2] at samples of the force, `interval_s` apart: exact where the force
        is linear between samples, and had its first value ever before.

        A straight step of the force is a ramp that begins and one that ends. A smooth force has to
        be sampled well above the resonance w, not only above its own frequencies: straight lines
        between samples add (w interval)^2/12 to a slow signal.
        """
        ramp = self.ramp_response(interval_s * np.arange(force_N.shape[-1]))
        steps = jnp.diff(force_N) / interval_s
        return jnp.pad(causal(jnp.diff(ramp), steps), ((0, 0), (1, 0)))

    @compiled
    def in_time_adjoint(
        self, y: Float[Array, "e sample"], interval_s: Float[Array, ""]
    ) -> Float[Array, "e sample"]:
        """The transpose: <y, in_time(f)> = <in_time_adjoint(y), f>."""
        (force,) = jax.linear_transpose(lambda f: self.in_time(f, interval_s), y)(y)
        return force

    def force(self) -> "ContactForce":
        """The force on the patch [N]."""
        return ContactForce(self)

    def output(self, scan: ConstantSpeed) -> "SkinAcceleration":
        """The acceleration [m/s^2] at constant speed, where omega = k u."""
        return SkinAcceleration(self, scan.speed_m_per_s, _nodes(self, scan.speed_m_per_s))

    def operator(self, line: Line, scan: ConstantSpeed) -> Convolution:
        """From traction on a line to the acceleration at the line's own positions, at constant
        speed."""
        return line.operator(self.output(scan))

    def operator_along(self, line: Line, motion: Motion) -> "AccelerationOperator":
        """From traction on a line to the acceleration at every sample of a measured motion.

        Raises `BadInput` for samples that are not evenly spaced, and for a motion beyond the ends
        of an open line.
        """
        force = MotionOperator(
            line,
            line.operator(self.force()),
            PositionInterpolation(line, motion.position_m),
            jnp.ones_like(motion.position_m),
            motion.direction,
        )
        return AccelerationOperator(self, force, even_interval(motion.time_s))

    def noise_rms_m_per_s2(self, sample_rate_hz: Float[Array, ""] | float) -> Float[Array, ""]:
        """Rms of its white noise in samples at this rate: the density over half of it."""
        return self.noise_density_m_per_s2_per_rtHz * jnp.sqrt(as_real(sample_rate_hz) / 2)

    def events(
        self, bursts: SnapBackNoise, key: PRNGKeyArray, line: Line, scan: ConstantSpeed
    ) -> Float[Array, "1 n"]:
        """Acceleration [m/s^2] of events of stick-slip, drawn one by one and periodic over the
        line's samples.

        They are those that `bursts.draw` gives the film for the same key, line and scan. The shear
        of each, times its patch's length along and across, is the force; only a tangential sensor
        responds. A sample is the mean over the sampling interval before it, as one of the film's
        rate signal is.
        """
        interval, per_s = bursts.interval_and_rate(line, scan)
        generator = self._generator(bursts)

        def contribution(along, age):
            del along  # the force is the same wherever the patch is
            return _states(generator, age * interval).T

        fresh = sum_over_events(key, per_s * line.n * interval, line.n, 3, contribution)
        transfer = self._sampled(generator, line, interval)
        signal = jnp.fft.irfft(jnp.sum(transfer * jnp.fft.rfft(fresh), axis=0), line.n)
        signal = self._force_of(bursts) * signal[None]
        return jnp.where(scan.direction < 0, signal[:, ::-1], signal)

    def event_spectrum(
        self, bursts: SnapBackNoise, line: Line, scan: ConstantSpeed
    ) -> Float[Array, " k"]:
        """Power per sample [(m/s^2)^2] of `events`, as `Noise.spectrum` has it."""
        interval, per_s = bursts.interval_and_rate(line, scan)
        generator = self._generator(bursts)
        states = _states(generator, interval * as_real((1 + AGES) / 2))
        each = states @ self._sampled(generator, line, interval)
        power = as_real(WEIGHTS / 2) @ jnp.abs(each) ** 2
        return per_s * interval * self._force_of(bursts) ** 2 * power

    def event(
        self, bursts: SnapBackNoise, time_s: Float[Array, " sample"]
    ) -> Float[Array, " sample"]:
        """Acceleration [m/s^2] of one event of rms shear, at times since it; 0 before it."""
        after = time_s >= 0
        states = _states(self._generator(bursts), jnp.where(after, time_s, 0.0))
        return jnp.where(after, self._force_of(bursts) * states @ self._read, 0.0)

    def _force_of(self, bursts: SnapBackNoise) -> Float[Array, ""]:
        """Force [N] of an event of rms shear."""
        if self.axis != "tangential":
            return as_real(0.0)
        return bursts.shear_Pa * bursts.patch_m * self.length_m

    @property
    def _read(self) -> Float[Array, "3"]:
        """The acceleration of the state (k x, sqrt(k m) x', F): that which is left of the force."""
        return jnp.stack([as_real(-1.0), -2 * self.damping_ratio, as_real(1.0)]) / self.mass_kg

    def _generator(self, bursts: SnapBackNoise) -> Float[Array, "3 3"]:
        """The rate [1/s] of that state, as the force relaxes."""
        turn, zero = self.resonance_rad_per_s, as_real(0.0)
        return jnp.stack([
            jnp.stack([zero, turn, zero]),
            jnp.stack([-turn, -2 * self.damping_ratio * turn, turn]),
            jnp.stack([zero, zero, -1 / bursts.decay_s]),
        ])  # fmt: skip

    def _sampled(
        self, generator: Float[Array, "3 3"], line: Line, interval: Float[Array, ""]
    ) -> Complex[Array, "3 k"]:
        """Transfer from fresh states to the acceleration, the difference of the velocity between
        samples over their interval: a row of (1 - z)/(1 - z step), by Faddeev and LeVerrier, z one
        sample's delay."""
        step = jax.scipy.linalg.expm(generator * interval)
        turn, zero = line.k * line.cell_m, as_real(0.0)
        velocity = 1 / (self.mass_kg * self.resonance_rad_per_s * interval)
        z, square, row = jnp.exp(-1j * turn), step @ step, jnp.stack([zero, velocity, zero])
        first = jnp.trace(step)
        second = (first**2 - jnp.trace(square)) / 2
        third = jnp.exp(jnp.trace(generator) * interval)
        above = (row, row @ step - first * row, row @ square - first * (row @ step) + second * row)
        top = sum(each[:, None] * z[None] ** power for power, each in enumerate(above))
        difference = 2j * jnp.sin(turn / 2) * jnp.exp(-0.5j * turn)  # 1 - z
        return (difference / (1 - first * z + second * z**2 - third * z**3))[None] * top


class ContactForce(Stage):
    """The force [N] on an accelerometer's patch, from traction (p, q)."""

    accelerometer: SkinAccelerometer

    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, "1 2 k"]:
        own = self.accelerometer
        return _of_axis(own, own.length_m * envelope_transform(k, own.contact_m) + 0j)

    def cell_response(
        self, x: Float[Array, " x"], cell_m: Float[Array, ""]
    ) -> Float[Array, "1 2 x"]:
        own = self.accelerometer
        ahead, behind = (
            envelope_integral(x + side * cell_m / 2, own.contact_m) for side in (1, -1)
        )
        return _of_axis(own, own.length_m * (ahead - behind))


class SkinAcceleration(Stage):
    """The acceleration [m/s^2] of an accelerometer that slides at constant speed, from (p, q).

    On the open line it is an integral over the contact, by Gauss's rule of `nodes` nodes.
    """

    accelerometer: SkinAccelerometer
    speed_m_per_s: Float[Array, ""]
    nodes: int = eqx.field(static=True)

    @property
    def has_dc_gain(self) -> bool:
        return False

    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, "1 2 k"]:
        response = self.accelerometer.response(k * self.speed_m_per_s)
        return self.accelerometer.force().transfer(k) * response[None, None]

    def cell_response(
        self, x: Float[Array, " x"], cell_m: Float[Array, ""]
    ) -> Float[Array, "1 2 x"]:
        refuse(
            self.nodes > MOST_NODES,
            f"The accelerometer rings {self.nodes / MOST_NODES:.2g} times too long for an open "
            "line: give more damping, a higher speed or grid.line=periodic.",
        )
        x = x * jnp.sign(self.speed_m_per_s)  # what was met before lies behind
        ahead, behind = (self._since_edge(x + side * cell_m / 2) for side in (1, -1))
        return _of_axis(self.accelerometer, self.accelerometer.length_m * (ahead - behind))

    def _since_edge(self, x: Float[Array, " x"]) -> Float[Array, " x"]:
        """Integral over y < x of envelope(y) times the step response at (x - y)/u, with
        y = a sin(angle): the integrand is smooth."""
        own, half = self.accelerometer, self.accelerometer.contact_m / 2
        speed = jnp.abs(self.speed_m_per_s)
        moves = speed > 0
        speed = jnp.where(moves, speed, 1.0)
        last = _angle(x / half)
        first = _angle((x - speed * E_FOLDS / _slowest(own)) / half)
        at, weights = np.polynomial.legendre.leggauss(self.nodes)
        width = (last - first) / 2
        angle = (last + first)[:, None] / 2 + width[:, None] * as_real(at)[None]
        lag = jnp.maximum(x[:, None] - half * jnp.sin(angle), 0.0) / speed
        each = own.step_response(lag) * jnp.cos(angle) ** 2
        return jnp.where(moves, half * width * (each @ as_real(weights)), 0.0)


class AccelerationOperator(Operator):
    """The acceleration (1, sample) [m/s^2] along a measured motion: the force at its samples,
    `interval_s` apart, and the oscillator in time."""

    accelerometer: SkinAccelerometer
    force: MotionOperator
    interval_s: Float[Array, ""]

    def __call__(self, traction: Float[Array, "*way c n"]) -> Float[Array, "1 sample"]:
        return self.accelerometer.in_time(self.force(traction), self.interval_s)

    def adjoint(self, signal: Float[Array, "1 sample"]) -> Float[Array, "c n"]:
        return self.force.adjoint(self.accelerometer.in_time_adjoint(signal, self.interval_s))


def _of_axis(accelerometer: SkinAccelerometer, values: Array) -> Array:
    """The response (1, 2, x) to p and q of a sensor that one of them drives."""
    zero = jnp.zeros_like(values)
    normal = accelerometer.axis == "normal"
    return jnp.stack([values, zero] if normal else [zero, values])[None]


def _decaying_sinhc(square: Float[Array, "..."], decay: Float[Array, "..."]) -> Float[Array, "..."]:
    """exp(-decay) sinh(z)/z for z^2 = `square` of either sign, z <= `decay`: no overflow, and with
    its derivatives where z is 0."""
    small = jnp.abs(square) < 1
    near, series = jnp.where(small, square, 0.0), 1.0
    for n in range(SERIES_TERMS, 0, -1):
        series = 1 + near * series / (2 * n * (2 * n + 1))
    z = jnp.sqrt(jnp.where(small, 1.0, jnp.abs(square)))
    turning = jnp.exp(-decay) * jnp.sin(z) / z
    # Where it turns, the exponent of the other branch would overflow.
    real = jnp.where(square > 0, z, 0.0)
    creeping = (jnp.exp(real - decay) - jnp.exp(-real - decay)) / (2 * z)
    return jnp.where(small, jnp.exp(-decay) * series, jnp.where(square > 0, creeping, turning))


def _states(
    generator: Float[Array, "3 3"], time_s: Float[Array, " time"]
) -> Float[Array, "time 3"]:
    """The states at times after a jump of the force by 1 N."""
    return jax.scipy.linalg.expm(generator[None] * time_s[:, None, None])[:, :, 2]


def _slowest(accelerometer: SkinAccelerometer) -> Float[Array, ""]:
    """The slowest rate of decay [1/s] of an accelerometer's two."""
    zeta = accelerometer.damping_ratio
    over = jnp.sqrt(jnp.where(zeta > 1, zeta**2 - 1, 1.0))
    # 1/(zeta + over) is zeta - over without cancelling.
    return accelerometer.resonance_rad_per_s * jnp.where(zeta > 1, 1 / (zeta + over), zeta)


def _nodes(accelerometer: SkinAccelerometer, speed_m_per_s: Float[Array, ""]) -> int:
    """Nodes that resolve the step response over the contact, or over its duration: a power of 2,
    so that similar sensors share one program."""
    if is_traced(accelerometer, speed_m_per_s):
        return TRACED_NODES
    zeta, speed = float(accelerometer.damping_ratio), abs(float(speed_m_per_s))
    lasts = E_FOLDS / float(_slowest(accelerometer))
    crossing = float(accelerometer.contact_m) / speed if speed else np.inf
    turns = min(crossing, lasts) * float(accelerometer.resonance_rad_per_s) * max(1.0, 2 * zeta)
    return int(2 ** np.ceil(np.log2(0.6 * turns + 32)))


def _angle(s: Float[Array, " x"]) -> Float[Array, " x"]:
    """arcsin(s), that of the nearer end beyond -1 and 1."""
    inside = jnp.abs(s) < 1
    return jnp.where(inside, jnp.arcsin(jnp.where(inside, s, 0.0)), np.pi / 2 * jnp.sign(s))
