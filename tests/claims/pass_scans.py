"""Recordings of passes for the studies of passes and of disturbances, and their exact posteriors.

The traction is drawn from the prior of the inversion, a random walk along x on its cells: then the
posterior's covariance is the expected square of the error, which no method is below. Or it is fixed
and realistic: two touches, on cells ten times finer. The signal at every sample is the sensor's
charge on a line at constant speed, interpolated to the sample's place and times its speed.
"""

from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from scipy.stats import norm

from srsinv.forward.amplifier import CurrentAmplifier
from srsinv.forward.film import Film
from srsinv.forward.scan import Motion
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Open
from srsinv.inverse.estimate import Estimate
from srsinv.inverse.line.problem import LineProblem
from srsinv.inverse.line.rule import Evidence
from srsinv.inverse.noise.model import SampleNoise
from srsinv.inverse.problem import Problem
from srsinv.inverse.tikhonov import Tikhonov
from srsinv.modules import with_fields

DEPTH_M, CELL_M, SPACING_M = 1.2e-3, 2e-4, 4e-5  # of samples at the steady speed
TURN = 50  # samples that a turn takes
NOISE_V = 1e-6
SIGNAL = 100.0  # the signal's rms over that of the noise
SHEAR = 0.3  # of q over p: where friction is known, and in scale where it is not
COLUMNS = 96  # of nuisance: a multiple of it is compiled for
FREE = 1e-9  # of the precision of a mean that is fixed: of one that is free
BAND = 0.9
LIMIT = float(norm.ppf((1 + BAND) / 2))
STAGE_M = 2e-4  # by so much the stage may be ahead of where it is said to be
Rng = np.random.Generator


def motion_of_passes(passes: int, length_m: float, speed_m_per_s: float) -> Motion:
    """The motion of so many passes, its samples at the same places whatever the speed."""
    steady = np.full(round(length_m / SPACING_M), 1.0)
    turn = -np.sin(np.linspace(-np.pi / 2, np.pi / 2, TURN))
    parts = [(-1) ** i * part for i in range(passes) for part in (steady, turn)][:-1]
    speed = speed_m_per_s * np.concatenate(parts)
    rate_Hz = speed_m_per_s / SPACING_M
    return Motion.from_speed(np.arange(speed.size) / rate_Hz, speed, -length_m / 2)


def two_touches(x):
    """A realistic traction (2, n), up to a factor: two pressures, under a friction that varies."""
    p = np.exp(-((x / 1.2e-3) ** 2)) + 0.5 * np.exp(-(((x - 5e-3) / 8e-4) ** 2))
    return np.stack([p, SHEAR * p * (1 + SHEAR * np.tanh(x / 2e-3))])


class Truth(NamedTuple):
    """A traction's deviation from its mean over the window on the inversion's cells (c, n) [Pa],
    and the charge that it makes at `PassScans.places` (e, way, place)."""

    traction: np.ndarray
    charge: np.ndarray


class DrawnErrors(NamedTuple):
    """Of each component's deviation from its mean over the scan: the error's mean square (c,)
    [Pa^2], and the fraction of cells whose band holds it (c,)."""

    square: np.ndarray
    covered: np.ndarray


class Held(NamedTuple):
    """An estimate under given weights: value and standard error (c, n) [Pa]."""

    value: np.ndarray
    stderr: np.ndarray


class PassScans:
    """Recordings along a motion by elements at these angles; `friction` None leaves p and q
    apart."""

    def __init__(self, moved: Motion, angles_deg=(0.0, 45.0), friction: float | None = None):
        films = [Film(DEPTH_M, np.deg2rad(each)).with_strip_average() for each in angles_deg]
        self.sensor = Sensor(films, HalfSpace(0.5, 7e5), CurrentAmplifier(1e8))
        self.motion, self.friction = moved, friction
        self.position, self.speed = (
            np.asarray(each) for each in (moved.position_m, moved.speed_m_per_s)
        )
        self.full_speed = float(np.max(np.abs(self.speed)))
        self.rate_Hz = self.full_speed / SPACING_M
        self.duration_s = self.position.size / self.rate_Hz
        self.shape = len(angles_deg), self.position.size
        first, last = np.min(self.position) - STAGE_M, np.max(self.position) + STAGE_M
        self.places = np.arange(first, last + SPACING_M, SPACING_M)
        self.line = self.problem(np.zeros(self.shape)).to_grid()
        charge = self._charge_on(self.line.line)
        unit = [self._walk(np.random.default_rng([0, i]), np.ones(2)) for i in range(100)]
        rms = np.sqrt(
            np.mean([self.signal(Truth(t, self._directions(charge, t))) ** 2 for t in unit])
        )
        self.step_Pa = SIGNAL * NOISE_V / rms * np.array([1.0, SHEAR])[: self.line.unknowns]
        self.charge = charge

    def _charge_on(self, line):
        """The charge (e, 2, place, n) at full speed from p and from q of each cell."""
        count = self.places.size
        along = Motion(
            np.arange(count) / self.rate_Hz, self.places, np.full(count, self.full_speed)
        )
        operator = self.sensor.operator_along(line, along, directions=(True,))
        basis = jnp.eye(2 * line.n).reshape(2, line.n, 2, line.n)
        each = np.asarray(jax.jit(jax.vmap(jax.vmap(operator)))(basis))  # (c, n, e, place)
        return np.transpose(each, (2, 0, 3, 1))

    def _directions(self, charge, traction):
        """The charge (e, way, place) of a traction: q turns with the motion."""
        p, q = traction if len(traction) == 2 else (traction[0], self.friction * traction[0])
        of_p, of_q = charge[:, 0] @ p, charge[:, 1] @ q
        return np.stack([of_p + of_q, of_p - of_q], axis=1)

    def _walk(self, rng: Rng, step_Pa):
        walk = np.cumsum(rng.normal(size=(self.line.unknowns, self.line.line.n)), axis=1)
        return step_Pa[: self.line.unknowns, None] * (walk - walk.mean(axis=1, keepdims=True))

    def drawn(self, rng: Rng) -> Truth:
        """A traction of the prior."""
        traction = self._walk(rng, self.step_Pa)
        return Truth(traction, self._directions(self.charge, traction))

    @cached_property
    def touches(self) -> Truth:
        """The realistic one."""
        line, fine = self.line.line, 10
        cell = float(line.cell_m) / fine
        many = Open(fine * line.n, cell, float(line.start_m) - cell * (fine - 1) / 2)
        traction = two_touches(np.asarray(many.x))
        if self.friction is not None:
            traction[1] = self.friction * traction[0]
        count = self.places.size
        along = Motion(
            np.arange(count) / self.rate_Hz, self.places, np.full(count, self.full_speed)
        )
        operator = self.sensor.operator_along(many, along, directions=(True,))
        directions = [
            np.asarray(operator(jnp.asarray(s * traction.T).T)) for s in ([1, 1], [1, -1])
        ]
        truth = Truth(traction, np.stack(directions, axis=1))
        size = SIGNAL * NOISE_V / np.sqrt(np.mean(self.signal(truth) ** 2))
        cells = size * traction[: self.line.unknowns].reshape(-1, line.n, fine).mean(axis=-1)
        return Truth(cells - cells.mean(axis=1, keepdims=True), size * truth.charge)

    def signal(self, truth: Truth, ahead_m=0.0):
        """The signal (e, sample) without noise; the stage `ahead_m` of where it is said to be."""
        spline = scipy.interpolate.make_interp_spline(self.places, truth.charge, axis=2)
        at = spline(self.position - ahead_m)
        direction = np.where(self.speed > 0, at[:, 0], at[:, 1])
        return direction * np.abs(self.speed) / self.full_speed * np.sign(self.speed)

    @cached_property
    def model(self):
        """The signals (e, sample, c n) of the line's tractions."""
        unknowns, n = self.line.unknowns, self.line.line.n
        p, q = np.moveaxis(self.charge, 1, 0)
        towards = np.sign(self.speed)[:, None]
        spline = scipy.interpolate.make_interp_spline(self.places, np.stack([p, q]), axis=2)
        p, q = spline(self.position)
        gain = self.speed[:, None] / self.full_speed
        rows = [p, towards * q] if unknowns == 2 else [p + towards * self.friction * q]
        return np.concatenate([gain * each for each in rows], axis=-1).reshape(
            (*self.shape, unknowns * n)
        )

    @cached_property
    def precision(self):
        """That of the prior (c n, c n); of the means over the window those are fixed that the
        package takes as known or as unobservable."""
        n, known = self.line.line.n, np.asarray(self.line.zero_mean)
        steps = np.diff(np.eye(n), axis=0)
        each = [steps.T @ steps / step**2 for step in self.step_Pa]
        factors = np.where(known, 1.0, FREE)
        return scipy.linalg.block_diag(
            *(one + f * np.trace(one) / n**2 for one, f in zip(each, factors, strict=True))
        )

    def problem(self, signal, drift: float = 0.0, lines=(), direction=None) -> Problem:
        """As the package is given it."""
        noise = SampleNoise(NOISE_V, drift=drift)
        given = Problem(self.sensor, self.motion, signal, noise,
                        friction=self.friction, cell_m=CELL_M, mains=lines)  # fmt: skip
        return given if direction is None else given.of_direction(direction)

    def held(self, problem: Problem | LineProblem) -> Held:
        """The package's posterior under the prior that tractions are drawn from, by dense algebra
        (tests/inverse/noise/test_nuisance.py has that its paths are the same)."""
        line = problem.to_grid()
        data, observed = np.asarray(line.data), np.asarray(line.is_observed)
        information, right = self.precision.copy(), 0.0
        for e, (model, cells) in enumerate(zip(self.cell_model, observed, strict=True)):
            root = scipy.linalg.cholesky(_covariance(line, e, cells), lower=True)
            rows = np.concatenate([model[cells], data[e, cells, None]], axis=1)
            rows = scipy.linalg.solve_triangular(root, rows, lower=True)
            information += rows[:, :-1].T @ rows[:, :-1]
            right = right + rows[:, :-1].T @ rows[:, -1]
        covariance = np.linalg.inv(information)
        n, weights = line.line.n, np.asarray(line.mean_weights)
        variance = []
        for c, weight in enumerate(weights):
            own = covariance[c * n : (c + 1) * n, c * n : (c + 1) * n]
            variance.append(np.diag(own) - 2 * own @ weight + weight @ own @ weight)
        return Held((covariance @ right).reshape(-1, n), np.sqrt(variance))

    @cached_property
    def cell_model(self):
        """The signals (e, n, c n) of the package's model on its cells."""
        n, unknowns = self.line.line.n, self.line.unknowns
        basis = jnp.eye(unknowns * n).reshape(-1, unknowns, n)
        return np.moveaxis(np.asarray(jax.vmap(self.line.forward)(basis)), 0, -1)

    @staticmethod
    def by_evidence(problem: Problem | LineProblem) -> Estimate:
        """The estimate under the weights that the evidence chooses."""
        method = Tikhonov(rule=Evidence(), length_m=DEPTH_M, path="direct")
        return method(_padded(problem.to_grid()))

    def floor(self, covariance=None):
        """The exact posterior's covariance of all samples in noise of this covariance (sample,
        sample), the same in all elements, and its map from the signals; None: white noise."""
        if covariance is None:
            weighed = self.model / NOISE_V**2
        else:
            root = scipy.linalg.cho_factor(covariance, lower=True)
            weighed = np.stack([scipy.linalg.cho_solve(root, each) for each in self.model])
        information = np.einsum("esi,esj->ij", self.model, weighed, optimize=True)
        posterior = np.linalg.inv(information + self.precision)
        return posterior, np.einsum("ij,esj->ies", posterior, weighed, optimize=True)

    @cached_property
    def floor_Pa(self):
        """The least rms error (c,) in white noise: that of the exact posterior."""
        return self.rms_of(self.floor()[0])

    def rms_of(self, covariance):
        """The rms (c,) of each component's deviation from its mean over the scan."""
        n, unknowns = self.line.line.n, self.line.unknowns
        centre = self.centre
        blocks = [covariance[c * n : (c + 1) * n, c * n : (c + 1) * n] for c in range(unknowns)]
        return np.sqrt([np.trace(centre @ each @ centre.T) / len(centre) for each in blocks])

    @cached_property
    def centre(self):
        """The cells of the scan less their mean, a matrix."""
        rows = np.eye(self.line.line.n)[np.asarray(self.line.observed_cells)]
        return rows - rows.mean(axis=0)

    def square(self, value, truth: Truth):
        """The mean square (c,) of the error of values on the line."""
        off = np.asarray(value)[: self.line.unknowns] - truth.traction
        return np.mean((off @ self.centre.T) ** 2, axis=1)

    def answer(self, estimate: Estimate | Held, truth: Truth) -> DrawnErrors:
        """The errors of an estimate, and what its bands cover."""
        unknowns, cells = self.line.unknowns, np.asarray(self.line.observed_cells)
        off = np.asarray(estimate.value)[:unknowns] - truth.traction
        off = off - np.sum(np.asarray(self.line.mean_weights) * off, axis=1, keepdims=True)
        inside = np.abs(off) < LIMIT * np.asarray(estimate.stderr)[:unknowns]
        return DrawnErrors(self.square(estimate.value, truth), inside[:, cells].mean(axis=1))


def _covariance(line: LineProblem, e: int, cells):
    """That of an element's noise and columns on the cells with samples."""
    power = np.asarray(line.noise)[min(e, len(line.noise) - 1)]
    covariance = scipy.linalg.toeplitz(np.fft.irfft(power, line.line.n))
    covariance = covariance[np.ix_(cells, cells)]
    if line.noise_scale is not None:
        scale = np.asarray(line.noise_scale)[e, cells]
        covariance = scale[:, None] * covariance * scale
    if line.nuisance is not None:
        columns = np.asarray(line.nuisance)[e][:, cells]
        covariance = covariance + columns.T @ columns
    return covariance


def _padded(problem: LineProblem) -> LineProblem:
    """The same problem with columns of nothing, so that one program serves all numbers of them."""
    if problem.nuisance is None:
        return problem
    count = -problem.nuisance.shape[1] % COLUMNS
    return with_fields(problem, nuisance=jnp.pad(problem.nuisance, ((0, 0), (0, count), (0, 0))))


def ratio_of(squares, others) -> tuple[float, float]:
    """The ratio of two rms errors of the same draws, and its standard error."""
    squares, others = np.asarray(squares), np.broadcast_to(others, np.shape(squares))
    ratio = np.mean(squares) / np.mean(others)
    spread = np.std(squares - ratio * others, ddof=1) / np.sqrt(squares.size) / np.mean(others)
    stderr = spread / (2 * np.sqrt(ratio))
    return float(np.sqrt(ratio)), float(stderr)
