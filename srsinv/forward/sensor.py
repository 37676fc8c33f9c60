"""The sensor: skin, film elements and amplifier composed into stages on a line."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..errors import all_of_kind, of_kind, refuse
from ..grid import Convolution, Line, Scalar, Stage, as_real
from ._checks import check_amplifier, check_poles, stress_in
from .amplifier import Amplifier, CurrentAmplifier
from .envelope import Envelope, Kernel, envelopes_of, line_load, over_cell, windowed
from .film import ORIENTATIONS_RAD, Film
from .filter import Filter, even_interval
from .operator import MotionOperator, PositionInterpolation
from .scan import ConstantSpeed, Motion
from .skin import HalfSpace, Skin
from .turned_skin import along_x


class FilmSignal(Stage):
    """gain * d^order/dx^order of every element's charge, from traction (p, q).

    `envelopes`: through which the finger presses the traction; none where it touches everywhere.
    """

    skin: Skin
    elements: tuple[Film, ...]
    gain: Float[Array, ""]
    order: int = eqx.field(static=True)
    envelopes: tuple[Envelope, ...] = ()

    @property
    def has_dc_gain(self) -> bool:
        return self.order == 0

    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, "e c k"]:
        charge = [self._charge(*pair, k) for pair in self._pairs]
        derivative = 1j * k[None, None] if self.order else 1.0
        return self.gain * derivative * jnp.stack(charge)

    def cell_response(
        self, x: Float[Array, " x"], cell_m: Float[Array, ""]
    ) -> Float[Array, "e c x"]:
        one = self._windowed_response if self.envelopes else self._response
        return self.gain * jnp.stack([one(*pair, x, cell_m) for pair in self._pairs])

    def series_radius_m(self, cell_m: Float[Array, ""]) -> Scalar:
        if self.envelopes:
            return np.inf
        radii = [
            film.series_radius_m(skin.series_radius_m(film.depth_m, cell_m))
            for film, skin in self._pairs
        ]
        return jnp.max(jnp.stack([as_real(radius) for radius in radii]))

    @property
    def _pairs(self) -> list[tuple[Film, Skin]]:
        """Each film with the skin in the axes of its strip."""
        return [along_x(film, self.skin) for film in self.elements]

    def _charge(self, film: Film, skin: Skin, k: Float[Array, " k"]) -> Complex[Array, "c k"]:
        def charge(film: Film, k):
            return film.charge_transfer(stress_in(skin, k, film.depth_m), k)

        if not self.envelopes:
            return charge(film, k)
        within = film.in_finger()
        transfer, _ = windowed(self.envelopes, lambda k: charge(within, k), _kernel(within, skin))
        factors = [effect.transfer(k)[None] for effect in film.signal_effects]
        return math.prod(factors, start=transfer(k))

    def _response(self, film: Film, skin: Skin, x, cell_m) -> Float[Array, "c x"]:
        respond = skin.strip_slope if self.order else skin.strip_response
        return film.charge_response(
            lambda x: respond(x, film.depth_m, cell_m), x, cell_m, self.order
        )

    def _windowed_response(self, film: Film, skin: Skin, x, cell_m) -> Float[Array, "c x"]:
        """The charge under a cell, or its slope: the difference of the kernel at the cell's ends,
        as the kernel's integral over the cell moves with the film."""
        _, kernel = windowed(self.envelopes, lambda k: k, _kernel(film.in_finger(), skin))

        def ends(x):
            return kernel(x + cell_m / 2) - kernel(x - cell_m / 2)

        response = ends if self.order else over_cell(self.envelopes, kernel, cell_m)
        for effect in film.signal_effects:
            response = effect.spread(response)
        return response(x)


def _kernel(film: Film, skin: Skin) -> Kernel:
    """The film's charge by its distance from a line load."""

    def charge(x, width_m):
        def stress(x):
            return skin.strip_response(x, film.depth_m, width_m)

        return film.charge_response(stress, x, width_m, 0)

    return line_load(charge, film.depth_m)


class FilmStress(Stage):
    """sigma_x, sigma_z, tau_xz, sigma_y [Pa] at every element's depth: rows element by element."""

    skin: Skin
    elements: tuple[Film, ...]
    envelopes: tuple[Envelope, ...] = ()

    def transfer(self, k: Float[Array, " k"]) -> Complex[Array, "e c k"]:
        def stress(film: Film):
            transfer, _ = windowed(
                self.envelopes, lambda k: self.skin.transfer(k, film.depth_m), self._kernel(film)
            )
            return transfer(k)

        return self._rows(stress)

    def cell_response(
        self, x: Float[Array, " x"], cell_m: Float[Array, ""]
    ) -> Float[Array, "e c x"]:
        def stress(film: Film):
            if not self.envelopes:
                return self.skin.strip_response(x, film.depth_m, cell_m)
            _, kernel = windowed(self.envelopes, lambda k: k, self._kernel(film))
            return over_cell(self.envelopes, kernel, cell_m)(x)

        return self._rows(stress)

    def _kernel(self, film: Film) -> Kernel:
        return line_load(
            lambda x, width_m: self.skin.strip_response(x, film.depth_m, width_m), film.depth_m
        )

    def _rows(self, stress) -> Array:
        return jnp.concatenate([stress(film) for film in self.elements])


def two_orientations() -> tuple[Film, ...]:
    """The paper's two elements, axis 1 along x and along z, each averaging over its width."""
    with jax.ensure_compile_time_eval():  # within a compiled program their numbers are known too
        angles = ORIENTATIONS_RAD.values()
        return tuple(Film(angle_rad=angle).with_strip_average() for angle in angles)


class Sensor(eqx.Module):
    """A sensor: film elements in a skin, read by one kind of amplifier and by filters.

    - `elements`: a list of `Film`s; None: two strips at right angles ([`two_orientations`][]).
    - `skin`: a `srsinv.kinds.Skin`; None: a homogeneous half space.
    - `amplifier`: a `srsinv.kinds.Amplifier`; None: a current amplifier.
    - `filters`: a list of `srsinv.kinds.Filter`s, in their order; none by default.
    - `envelopes`: a list of `srsinv.kinds.Envelope`s, as `[HertzPatch(5e-3)]`, that the finger
      presses through; none where it touches the whole surface.

    These defaults are the command's. `operator(line, scan)` and `operator_along(line, motion)` map
    traction (2, n) [Pa] on a line to signals (element, sample). Raises `BadInput` for no element,
    and for parts of another kind.
    """

    skin: Skin
    elements: tuple[Film, ...]
    amplifier: Amplifier
    filters: tuple[Filter, ...]
    envelopes: tuple[Envelope, ...]

    def __init__(
        self,
        elements: Sequence[Film] | None = None,
        skin: Skin | None = None,
        amplifier: Amplifier | None = None,
        filters: Sequence[Filter] = (),
        envelopes: Sequence[Envelope] = (),
    ):
        films = two_orientations() if elements is None else elements
        self.elements = all_of_kind("elements", films, Film, "films, as [Film()]")
        wanted = "give at least 1 in sensor.elements"
        refuse(not self.elements, f"The sensor has 0 film elements: {wanted}.")
        skin = HalfSpace() if skin is None else skin
        self.skin = of_kind("skin", skin, Skin, "a skin, such as HalfSpace()")
        amplifier = CurrentAmplifier() if amplifier is None else amplifier
        wanted = "an amplifier, such as CurrentAmplifier()"
        self.amplifier = of_kind("amplifier", amplifier, Amplifier, wanted)
        check_amplifier(amplifier)
        self.filters = all_of_kind("filters", filters, Filter, "filters, as [FirstOrder(1e-4)]")
        for each in self.filters:
            check_poles(each)
        self.envelopes = envelopes_of(envelopes, self.depth_m) if len(envelopes) else ()

    def with_films(self, change: Callable[[Film], Film]) -> "Sensor":
        """The sensor with `change` applied to every film element."""
        films = tuple(change(film) for film in self.elements)
        return dataclasses.replace(self, elements=films)

    def with_envelope(self, envelope: Envelope) -> "Sensor":
        """The sensor that presses through one more envelope. Raises `BadInput` for a second contact
        zone."""
        return dataclasses.replace(self, envelopes=(*self.envelopes, envelope))

    def touching_everywhere(self) -> "Sensor":
        """The sensor without envelopes: under a load that is known, whatever the finger touches."""
        return dataclasses.replace(self, envelopes=()) if self.envelopes else self

    def in_both_directions(self) -> "Sensor":
        """The sensor with each film once for motion to +x, then once for motion back."""
        films = (*self.elements, *(film.backward() for film in self.elements))
        return dataclasses.replace(self, elements=films)

    def require_elements(self, count: int) -> None:
        """Raises `BadInput` unless there are so many film elements, one or two."""
        elements, name = len(self.elements), {1: "one_element", 2: "two_element"}[count]
        refuse(
            elements != count,
            f"sensor has {elements} elements, but this job needs {count}: give sensor={name}.",
        )

    @property
    def element_names(self) -> list[str]:
        """A short name for every film element: its number and its angle."""
        known, names = {0.0: "1 to x, 3 to z", 90.0: "1 to z, 3 to x"}, []
        onwards = sum(not film.is_backward for film in self.elements)
        for i, film in enumerate(self.elements):
            angle = float(np.rad2deg(film.angle_rad))
            own = known.get(round(angle, 6), f"at {angle:.4g} deg")
            if film.turn_rad is not None:
                own += f", turned {float(np.rad2deg(film.turn_rad)):.4g} deg"
            names.append(f"{i % onwards}: {own}, back" if film.is_backward else f"{i}: {own}")
        return names

    @property
    def depth_m(self) -> Float[Array, ""]:
        """Depth of the shallowest element."""
        return jnp.min(jnp.stack([film.depth_m for film in self.elements]))

    def stress(self) -> FilmStress:
        """Stress at the film [Pa]."""
        return FilmStress(self.skin, self.elements, self.envelopes)

    def film_signal(self, gain: Float[Array, ""], order: int) -> FilmSignal:
        """The stage of `gain` times the charge, or times its derivative along x for `order` 1."""
        return FilmSignal(self.skin, self.elements, gain, order, self.envelopes)

    def charge(self) -> FilmSignal:
        """Film charge [C]."""
        return self.film_signal(as_real(1.0), 0)

    def current(self, scan: ConstantSpeed) -> FilmSignal:
        """Film current i = u dQ/dx [A]: the paper's (3)."""
        return self.film_signal(scan.speed_m_per_s, 1)

    def output(self, scan: ConstantSpeed) -> FilmSignal:
        """The recorded signal less its offset, in the amplifier's unit."""
        gain, films = self.amplifier.at_speed(scan.speed_m_per_s), []
        for film in self.elements:
            speed = -scan.speed_m_per_s if film.is_backward else scan.speed_m_per_s
            for each in self.filters:  # at constant speed they act along the line
                film = film.with_effect(each.along(speed, film.depth_m))
            films.append(film)
        return dataclasses.replace(
            self.film_signal(gain, self.amplifier.order), elements=tuple(films)
        )

    def operator(self, line: Line, scan: ConstantSpeed) -> Convolution:
        """From traction on a line to the recorded signal less its offset, at constant speed and at
        the line's own positions."""
        return line.operator(self.output(scan))

    def operator_along(
        self,
        line: Line,
        motion: Motion,
        reach_m: float | None = None,
        directions: tuple[bool, ...] = (True, False),
    ) -> MotionOperator:
        """From traction on a line to the recorded signal less its offset, at every sample of a
        measured motion.

        `reach_m`: how far traction may go on beyond the line's last cell; None: nowhere.
        `directions`: as the motion has them, where that is known. Raises `BadInput` for an
        amplifier that needs a constant speed, for a motion beyond the ends of an open line, and
        with filters for samples that are not evenly spaced.
        """
        gain = self.amplifier.at_speed(motion.speed_m_per_s)
        # What the amplifier reads of the charge, before its gain.
        field = self.film_signal(as_real(1.0), self.amplifier.order)
        interval = even_interval(motion.time_s) if self.filters else None
        end = None
        if reach_m is not None:
            away = motion.position_m - (line.x[-1] + line.cell_m / 2 + reach_m / 2)
            end = gain[None, None] * field.cell_response(away, as_real(reach_m))
        return MotionOperator(
            line, line.operator(field),
            PositionInterpolation(line, motion.position_m), gain, motion.direction, self.filters,
            interval, end, directions,
        )  # fmt: skip
