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

from srsinv.errors import BadInput, refuse
from srsinv.forward.noise import Noise, total_spectrum
from srsinv.forward.scan import ConstantSpeed
from srsinv.forward.scene import Scene, SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.surface import Ridge, Surface
from srsinv.grid import Line, Periodic
from srsinv.inverse.detection import last_crossing, resolved_wavelength_m
from srsinv.numerics import is_flat


class RidgeTractions(NamedTuple):
    """Traction (2, n) [Pa] of every ridge, and of every pair with its derivatives by height,
    position and distance; `converged` of all."""

    heights_m: Float[np.ndarray, " height"]
    distances_m: Float[np.ndarray, " distance"]
    ridge: Float[Array, "height 2 n"]
    pair: Float[Array, "distance 2 n"]
    slopes: Float[Array, "distance 3 2 n"]
    converged: bool


class RidgeLimits(NamedTuple):
    """Limits [m]: the least ridge that is detected, the narrowest pair whose distance a fit
    resolves, the shortest wave that is recovered without a model."""

    least_height: float
    narrowest_pair: float
    resolved_wavelength: float


class RidgeDetection(NamedTuple):
    """A sensor that slides over one ridge, on a periodic line."""

    line: Line
    scene: SurfaceScene
    ridge: Ridge
    sensor: Sensor
    scan: ConstantSpeed

    @classmethod
    def checked(
        cls, line: Line, scene: Scene, sensor: Sensor, scan: ConstantSpeed
    ) -> "RidgeDetection":
        """Raises `BadInput` for another surface than one ridge, a line that is not periodic, and a
        speed that is not positive."""
        surface = scene.contact_scene
        ridge = surface and surface.surface.only(Ridge)
        if surface is None or ridge is None:
            raise BadInput("The scene is not one ridge: use scene=ridge.")
        refuse(not isinstance(line, Periodic), "grid.line is open: give periodic.")
        scan.require_onwards()
        return cls(line, surface, ridge, sensor, scan)

    def pair_distances(
        self, name: str, wanted_m: Float[np.ndarray, " wanted"]
    ) -> Float[np.ndarray, " distance"]:
        """Increasing distances of a pair in whole pairs of cells, nearest to those wanted, each
        once. Raises `BadInput` for `name`, where they do not fit between ridge and window."""
        line, step = self.line, 2 * float(self.line.cell_m)
        distances = step * np.unique(np.round(wanted_m / step))
        width, window = float(self.ridge.width_m), line.n * float(line.cell_m)
        refuse(
            not width + step < distances[0] < distances[-1] < window / 2,
            f"{name} is {[float(wanted_m[0]), float(wanted_m[-1])]}: give distances above "
            f"the ridge's width {width:g} m by more than {step:g} m, and below half the "
            f"window's {window:g} m.",
        )
        return distances

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
        converged = bool(right.all() & as_well.all())
        return RidgeTractions(heights_m, distances_m, single, both, slopes, converged)

    def _placed(self, height_m, position_m) -> Ridge:
        return eqx.tree_at(lambda r: (r.height_m, r.position_m), self.ridge, (height_m, position_m))

    def _traction(self, shapes: tuple[Ridge, ...]):
        surface = Surface(shapes, self.scene.surface.base_friction)
        contact = eqx.tree_at(lambda s: s.surface, self.scene, surface).contact(self.line)
        p = contact.pressure_Pa
        return jnp.stack([p, surface.friction(self.line) * p]), contact.converged

    def _detectability(self, tractions: RidgeTractions, rate_hz: float):
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

        return at

    def limits(
        self, tractions: RidgeTractions, rate_hz: float, needed: float, precision: float
    ) -> Callable[..., RidgeLimits]:
        """Map from (depth [m], noise [V rms of a sample], speed [m/s]) to the limits: a ridge is
        detected at the strength `needed`, a pair resolved where its distance is known to one part
        in `precision`."""
        detectability = self._detectability(tractions, rate_hz)
        heights, distances = tractions.heights_m, tractions.distances_m

        def of(depth: float, noise: float, speed: float) -> RidgeLimits:
            given = jnp.asarray(depth, float), jnp.asarray(speed, float)
            ridge, pair, stderr = (np.asarray(each) for each in detectability(*given))
            return RidgeLimits(
                last_crossing(heights, needed * noise / ridge),
                last_crossing(distances, precision * noise * stderr / distances),
                resolved_wavelength_m(depth, pair[-1] / noise),
            )

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
            not spectrum.min() > 0 or not is_flat(spectrum),
            "The noise is not white, which this experiment needs: give noise=[johnson] "
            "or noise=[white].",
        )
        return float(np.sqrt(spectrum[0]))
