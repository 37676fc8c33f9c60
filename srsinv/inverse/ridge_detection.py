"""Detectability of a ridge and resolvability of a pair, of a sensor that slides over them.

The contact is solved once for each ridge and each pair: it is the only nonlinear part, and does not
depend on the film's depth, the noise and the speed.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import refuse
from ..forward.noise import Noise, total_spectrum
from ..forward.scan import ConstantSpeed
from ..forward.scene import SurfaceScene
from ..forward.sensor import Sensor
from ..forward.surface import Ridge, Surface
from ..grid import Line, Periodic

Detectability = Callable[[float, float], tuple[np.ndarray, np.ndarray, np.ndarray]]


class RidgeTractions(NamedTuple):
    """Traction (2, n) [Pa] of every ridge, and of every pair with its derivatives by height,
    position and distance; `converged` of all."""

    ridge: Float[Array, "height 2 n"]
    pair: Float[Array, "distance 2 n"]
    slopes: Float[Array, "distance 3 2 n"]
    converged: bool


class RidgeDetection(NamedTuple):
    """A sensor that slides over one ridge, on a periodic line."""

    line: Line
    scene: SurfaceScene
    ridge: Ridge
    sensor: Sensor
    scan: ConstantSpeed

    def tractions(
        self, heights_m: Float[np.ndarray, " height"], distances_m: Float[np.ndarray, " distance"]
    ) -> RidgeTractions:
        """Contact with single ridges of `heights_m` and pairs at `distances_m`, of whole pairs of
        cells.

        Ridges are moved by whole cells: the derivative of the contact jumps where a cell touches or
        parts on a steep edge, which would scatter the standard errors by a tenth.
        """
        line, ridge = self.line, self.ridge

        def pair(height, cells):
            sides = (ridge.position_m + each * line.cell_m for each in (-cells, cells))
            return self._traction(tuple(self._placed(height, side) for side in sides))

        def with_slopes(cells):
            (here, right), (by_height, _) = jax.jvp(
                lambda height: pair(height, cells),
                (ridge.height_m,),
                (jnp.ones_like(ridge.height_m),),
            )
            by_place = (jnp.roll(here, -1, -1) - jnp.roll(here, 1, -1)) / (2 * line.cell_m)
            apart, near = pair(ridge.height_m, cells + 1)[0], pair(ridge.height_m, cells - 1)[0]
            by_distance = (apart - near) / (4 * line.cell_m)
            return here, jnp.stack([by_height, by_place, by_distance]), right

        def one(height):
            return self._traction((self._placed(height, ridge.position_m),))

        single, right = jax.jit(lambda h: jax.lax.map(one, h))(jnp.asarray(heights_m))
        cells = jnp.round(jnp.asarray(distances_m) / (2 * line.cell_m))
        both, slopes, as_well = jax.jit(lambda d: jax.lax.map(with_slopes, d))(cells)
        return RidgeTractions(single, both, slopes, bool(right.all() & as_well.all()))

    def _placed(self, height_m, position_m) -> Ridge:
        return eqx.tree_at(lambda r: (r.height_m, r.position_m), self.ridge, (height_m, position_m))

    def _traction(self, shapes: tuple[Ridge, ...]):
        surface = Surface(shapes, self.scene.surface.base_friction)
        contact = eqx.tree_at(lambda s: s.surface, self.scene, surface).contact(self.line)
        p = contact.pressure_Pa
        return jnp.stack([p, surface.friction(self.line) * p]), contact.converged

    def detectability(self, tractions: RidgeTractions, rate_hz: float) -> Detectability:
        """Map from (depth [m], speed [m/s]), in white noise of 1 V in each sample, to d' (height,)
        of single ridges, d' and the Cramer-Rao standard error [m] of the distance (distance,) of
        pairs, whose height and position are unknown as well. One program for all."""
        line, sensor = self.line, self.sensor

        @jax.jit
        def at(depth, speed):
            moved = [film.depth_m + depth - sensor.depth_m for film in sensor.elements]
            deeper = eqx.tree_at(lambda s: [film.depth_m for film in s.elements], sensor, moved)
            field = deeper.operator(line, ConstantSpeed(speed))
            samples = rate_hz / speed * line.cell_m  # for each cell

            def strength(traction):
                return jnp.sqrt(samples * jnp.sum(field(traction) ** 2))

            def stderr(slopes):
                columns = jnp.sqrt(samples) * jax.vmap(field)(slopes).reshape(3, -1)
                # Scaled: heights are in micrometres, distances in millimetres.
                size = jnp.linalg.norm(columns, axis=1)
                triangle = jnp.linalg.qr((columns / size[:, None]).T, mode="r")
                return 1 / (jnp.abs(triangle[2, 2]) * size[2])

            return (
                jax.lax.map(strength, tractions.ridge),
                jax.lax.map(strength, tractions.pair),
                jax.lax.map(stderr, tractions.slopes),
            )

        def of(depth_m, speed_m_per_s):
            one, pair, stderr = at(jnp.asarray(depth_m, float), jnp.asarray(speed_m_per_s, float))
            return np.asarray(one), np.asarray(pair), np.asarray(stderr)

        return of

    def noise_rms(
        self, noises: tuple[Noise, ...], tractions: RidgeTractions, rate_hz: float
    ) -> float:
        """The white noise [V rms] of one sample at `rate_hz`. Raises `BadInput` for noise that is
        not white."""
        samples = Periodic(self.line.n, float(self.scan.speed_m_per_s) / rate_hz, 0.0)
        signal = self.sensor.operator(self.line, self.scan)(tractions.pair[-1])
        rms = jnp.sqrt(jnp.mean(signal**2))
        spectrum = np.asarray(total_spectrum(noises, samples, self.scan, rms))
        refuse(
            not spectrum.min() > 0 or float(np.ptp(spectrum)) > 1e-9 * spectrum.max(),
            "The noise is not white, which is assumed here: give noise=[johnson] or noise=[white].",
        )
        return float(np.sqrt(spectrum[0]))
